"""The scene for three.js and Unity, read back from its GLB."""

import io
import math

import numpy as np
import pytest
import trimesh

from mrnav_server.app.twin_scene import ToolShape, scene_glb
from mrnav_server.core.areas import CriticalAreas
from mrnav_server.core.frames import Affine2, Calibration, VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.vessel_model import vessel_map


def calibration(stage: Affine2) -> Calibration:
    return Calibration(
        image_from_vessel=Affine2.scale(1.0),
        stage_from_vessel=stage,
        um_per_px=10.0,
        floor_z_um=2000.0,
        critical_height_um=11_000.0,
        magnet_offset_um=(0.0, 0.0),
        image_center_px=(200.0, 200.0),
    )


PLAIN = Affine2(10.0, 0.0, 0.0, 10.0, 1000.0, 500.0)


def ring() -> VesselMap:
    """A vessel that runs around an island of tissue."""
    y, x = np.mgrid[:600, :600]
    away = np.hypot(x - 300, y - 300)
    return vessel_map("ring", np.where((away > 60) & (away < 240), 255, 0).astype(np.uint8))


def loaded(model: VesselMap, stage: Affine2 = PLAIN, tool: ToolShape | None = None) -> trimesh.Scene:
    areas = CriticalAreas(model)
    areas.add(VesselPoint(150.0, 300.0), 400.0, "")
    glb = scene_glb(model, calibration(stage), areas.list(), tool or ToolShape(), 2500.0)
    scene = trimesh.load_scene(io.BytesIO(glb), file_type="glb")
    assert isinstance(scene, trimesh.Scene)
    return scene


def place_m(scene: trimesh.Scene, node: str) -> list[float]:
    matrix, _ = scene.graph[node]
    return [float(v) for v in matrix[:3, 3]]


def test_the_walls_stand_where_the_mask_is_black() -> None:
    model = ring()
    scene = loaded(model)
    walls = scene.geometry["vessel"]
    assert walls.is_watertight
    low, high = walls.bounds
    assert low == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert high == pytest.approx([6e-3, 2.5e-3, 6e-3], rel=1e-6)
    tissue_m2 = float((~model.lumen).sum()) * 1e-10
    assert walls.volume == pytest.approx(tissue_m2 * 2.5e-3, rel=0.01)
    away_m = np.hypot(walls.vertices[:, 0] - 3e-3, walls.vertices[:, 2] - 3e-3)
    corner = away_m > 4e-3
    assert corner.sum() >= 8
    assert set(np.round(away_m[~corner] * 1e3, 1)) <= {0.6, 2.4}


def test_robot_and_areas_are_as_large_as_they_are_and_where_they_are() -> None:
    scene = loaded(ring())
    assert scene.geometry["robot"].extents == pytest.approx([1e-3] * 3, rel=0.01)
    assert place_m(scene, "area:area-1") == pytest.approx([1.5e-3, 2e-5, 3e-3])
    disc = scene.geometry[scene.graph["area:area-1"][1]]
    assert disc.extents == pytest.approx([8e-4, 4e-5, 8e-4], rel=0.02)


@pytest.mark.parametrize(
    ("stage", "towards"),
    [(PLAIN, (1.0, 0.0)), (Affine2(0.0, 10.0, -10.0, 0.0, 0.0, 0.0), (0.0, 1.0))],
)
def test_the_needle_leans_as_the_stage_says(stage: Affine2, towards: tuple[float, float]) -> None:
    scene = loaded(ring(), stage, ToolShape(tilt_deg=45.0, azimuth_deg=0.0))
    centre = scene.geometry["needle"].centroid
    lean = np.array([towards[0], 1.0, towards[1]]) / math.sqrt(2.0)
    assert centre / np.linalg.norm(centre) == pytest.approx(lean, abs=0.01)
    assert scene.geometry["magnet"].centroid == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


def test_it_says_what_a_client_needs() -> None:
    extras = loaded(ring()).metadata
    assert extras["m_per_px"] == pytest.approx(1e-5)
    assert extras["stage_from_vessel"] == [[10.0, 0.0, 1000.0], [0.0, 10.0, 500.0]]
    assert extras["floor_z_um"] == 2000.0
