"""The tip's map: nine parameters come back from noisy points; rasters that cannot give them are refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.camera_map import TipMap
from mrnav_server.core.errors import RefusedError
from mrnav_server.vision.tip_fit import FEWEST_POINTS, fit_tip, floor_z_um, stage_from_floor

FLOOR_Z_UM = 2000.0


def camera(
    x_um: float = 11_500.0, y_um: float = 9000.0, height_um: float = 68_000.0, turn: float = 0.03
) -> TipMap:
    """A camera over a stage whose floor frame is turned and mirrored: q = M·xy + t on the floor."""
    cos, sin = np.cos(turn), np.sin(turn)
    linear = np.array([[cos, sin], [sin, -cos]])
    shift = np.array([-9000.0, 12_000.0])
    pupil, z_um = linear @ [x_um, y_um] + shift, FLOOR_Z_UM + height_um
    share = height_um / z_um
    offset = share * shift + pupil * FLOOR_Z_UM / z_um
    matrix = np.column_stack([share * linear, (offset - pupil) / z_um])
    return TipMap(tuple(matrix.ravel().tolist()), (float(offset[0]), float(offset[1])), z_um)


def raster(half_um: float = 3500.0, heights: tuple[float, ...] = (16_000.0, 12_500.0, 9000.0)) -> FloatArray:
    line = (-half_um, 0.0, half_um)
    return np.array([(10_000.0 + x, 10_000.0 + y, z) for z in heights for y in line for x in line])


@settings(max_examples=25, deadline=None)
@given(
    x_um=st.floats(0, 20_000),
    y_um=st.floats(0, 20_000),
    height_um=st.floats(40_000, 200_000),
    turn=st.floats(-3.0, 3.0),
)
def test_exact_points_give_the_map_back(x_um: float, y_um: float, height_um: float, turn: float) -> None:
    true = camera(x_um, y_um, height_um, turn)
    tips = raster()
    fit = fit_tip(tips, true.floor(tips))
    assert fit.residuals.max_um < 1e-3
    assert fit.map.camera_z_um == pytest.approx(true.camera_z_um, rel=1e-4)
    other = np.array([[6000.0, 14_000.0, 14_300.0]])
    assert fit.map.floor(other) == pytest.approx(true.floor(other), abs=1e-2)
    assert floor_z_um(fit.map, 0.0) == pytest.approx(FLOOR_Z_UM, abs=1.0)


def test_the_stage_follows_from_the_map() -> None:
    true = camera()
    stage = stage_from_floor(true)
    xy = np.array([12_345.0, 6789.0])
    hidden = true.floor(np.array([*xy, FLOOR_Z_UM]))
    assert stage(*hidden.tolist()) == pytest.approx(tuple(xy))


def test_water_is_taken_off_the_floors_height() -> None:
    assert floor_z_um(camera(), 750.0) == pytest.approx(FLOOR_Z_UM - 750.0)


def test_noise_is_told_by_the_residual_and_held_out_points_confirm_it() -> None:
    true, rng = camera(), np.random.default_rng(3)
    tips = raster()
    held_out = rng.uniform([7000, 7000, 11_500], [13_000, 13_000, 13_500], (40, 3))
    rms, errors = [], []
    for _ in range(20):
        fit = fit_tip(tips, true.floor(tips) + rng.normal(0.0, 4.0, (27, 2)))
        rms.append(fit.residuals.rms_um)
        errors.append(np.linalg.norm(fit.map.floor(held_out) - true.floor(held_out), axis=1))
        assert fit.residuals.leave_one_out_um > fit.residuals.rms_um
    assert np.sqrt(np.mean(np.square(rms))) == pytest.approx(4.0 * np.sqrt(2), rel=0.1)
    assert np.sqrt(np.mean(np.square(errors))) < 4.0


def test_three_points_are_never_enough() -> None:
    true = camera()
    for count in range(FEWEST_POINTS):
        tips = raster()[:: max(1, 27 // max(count, 1))][:count]
        with pytest.raises(RefusedError, match="three points"):
            fit_tip(tips.reshape(-1, 3), true.floor(tips.reshape(-1, 3)))


def test_a_raster_that_cannot_tell_is_refused() -> None:
    true = camera()
    line = raster()
    line[:, 1] = line[:, 0] * 0.3
    flat = raster(heights=(12_000.0, 11_900.0, 11_800.0))
    for tips, said in ((line, "on a line"), (flat, "two heights"), (raster(300.0), "on a line")):
        with pytest.raises(RefusedError, match=said):
            fit_tip(tips, true.floor(tips))


def test_points_that_do_not_follow_are_refused() -> None:
    tips, rng = raster(), np.random.default_rng(1)
    hidden = camera().floor(tips)
    with pytest.raises(RefusedError, match="µm RMS"):
        fit_tip(tips, hidden + rng.normal(0.0, 30.0, hidden.shape))
    hidden[4] += 80.0
    with pytest.raises(RefusedError, match="at most"):
        fit_tip(tips, hidden)
