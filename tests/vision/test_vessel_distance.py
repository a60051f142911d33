"""The distance to the wall is the same to the last bit, whatever computes it: a replay goes by it."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model


@pytest.fixture(params=[1, 2])
def _threads(request: pytest.FixtureRequest) -> Iterator[None]:
    before = cv2.getNumThreads()
    cv2.setNumThreads(request.param)
    yield
    cv2.setNumThreads(before)


@pytest.mark.usefixtures("_threads")
def test_a_distance_is_the_root_of_a_whole_number_to_the_last_bit() -> None:
    distance_px = load_vessel_model(find_model("bifurcation")).distance_px
    squares = np.rint(np.square(distance_px, dtype=np.float64))
    assert np.array_equal(np.abs(distance_px), np.sqrt(squares).astype(np.float32))
