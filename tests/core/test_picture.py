"""The camera's picture: ranges and centre."""

import math

import pytest

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.picture import PictureFormat


@pytest.mark.parametrize(
    ("name", "value"),
    [("width_px", 63), ("height_px", 8193), ("fps", 0.0), ("fps", math.nan), ("fps", math.inf)],
)
def test_a_format_out_of_range_is_named(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"camera.{name} is"):
        PictureFormat(**{name: value})  # type: ignore[arg-type]


def test_the_centre_of_a_picture_is_counted_from_its_first_pixels_centre() -> None:
    assert PictureFormat(64, 65).center_px == (31.5, 32.0)
