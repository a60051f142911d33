"""The rig as a scene for three.js and Unity: one GLB, in metres, whose nodes clients move.

glTF's frame is right-handed with y up. Here x and z are the vessel grid's x and y, so that a look straight
down is the microscope's picture, and y is the height over the vessel's floor.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from mrnav_server.core.frames import Calibration
from mrnav_server.core.records import CriticalArea
from mrnav_server.core.vessel import VesselMap

_OUTLINE_PX = 1.5
"""The outline strays from the mask by no more than this."""
_PLATE_UM = 1000.0
_NEEDLE_UM = 12_000.0
_ARM_UM = (30_000.0, 12_000.0, 12_000.0)
_LOOKS = {
    "vessel": ((0.62, 0.70, 0.78, 1.0), 0.0, 0.7),
    "plate": ((0.16, 0.18, 0.21, 1.0), 0.0, 0.9),
    "robot": ((0.34, 0.71, 0.91, 1.0), 0.5, 0.35),
    "magnet": ((0.90, 0.62, 0.00, 1.0), 0.4, 0.4),
    "needle": ((0.75, 0.77, 0.80, 1.0), 0.8, 0.3),
    "arm": ((0.30, 0.33, 0.37, 1.0), 0.3, 0.6),
    "area": ((0.00, 0.62, 0.45, 0.55), 0.0, 0.8),
}
"""Colour, metalness and roughness by what it is; the colours are those of the page."""


@dataclass(frozen=True, slots=True)
class ToolShape:
    """What the manipulator carries.

    Attributes:
        magnet_diameter_um: Diameter of the magnet.
        magnet_length_um: Its length, along the needle.
        tilt_deg: The needle's tilt from the vertical.
        azimuth_deg: Where it leans to, in the stage's x-y plane.
    """

    magnet_diameter_um: float = 1000.0
    magnet_length_um: float = 2000.0
    tilt_deg: float = 45.0
    azimuth_deg: float = 0.0


def scene_glb(
    vessel: VesselMap,
    calibration: Calibration,
    areas: Sequence[CriticalArea],
    tool: ToolShape,
    depth_um: float = 2500.0,
) -> bytes:
    """Return the scene as GLB.

    Nodes: ``vessel`` (walls) and ``plate`` stand; ``robot`` is moved to where the robot is; ``tool`` with
    ``magnet``, ``needle`` and ``arm`` in it has its origin at the tip; ``area:<id>`` lies on the floor. The
    scene's extras say how stage and grid become metres.

    Args:
        vessel: The vessel model.
        calibration: How it and the manipulator see each other.
        areas: The critical areas.
        tool: What the manipulator carries.
        depth_um: Height of the vessel's walls.
    """
    import trimesh

    scene = trimesh.Scene(base_frame="rig")
    walls, plate = _vessel_meshes(vessel, depth_um)
    scene.add_geometry(walls, node_name="vessel", geom_name="vessel")
    scene.add_geometry(plate, node_name="plate", geom_name="plate")
    radius_m = vessel.robot_radius_px * vessel.um_per_px * 1e-6
    robot = _coloured(trimesh.creation.icosphere(subdivisions=3, radius=radius_m), "robot")
    middle_m = vessel.size_px * vessel.um_per_px * 0.5e-6
    scene.add_geometry(
        robot, node_name="robot", geom_name="robot", transform=_at(middle_m, radius_m, middle_m)
    )
    lift_m = (depth_um + 2.0 * calibration.critical_height_um) * 1e-6
    scene.graph.update("tool", "rig", matrix=_at(middle_m, lift_m, middle_m))
    for name, mesh in _tool_meshes(tool, calibration).items():
        scene.add_geometry(mesh, node_name=name, geom_name=name, parent_node_name="tool")
    for area in areas:
        # In mm: trimesh takes triangles of some µm for degenerate.
        disc = trimesh.creation.annulus(0.85e-3 * area.epsilon_um, 1e-3 * area.epsilon_um, 0.04)
        disc.apply_transform(_Y_UP)
        disc.apply_scale(1e-3)
        x_m, z_m = (1e-6 * vessel.um_per_px * v for v in (area.center.x_px, area.center.y_px))
        name, place = f"area:{area.id}", _at(x_m, 2e-5, z_m)
        scene.add_geometry(_coloured(disc, "area"), node_name=name, geom_name=name, transform=place)
    scene.metadata.update(_extras(vessel, calibration, depth_um))
    glb = scene.export(file_type="glb", include_normals=True)
    if not isinstance(glb, bytes):
        raise TypeError("the scene was not exported as bytes")
    return glb


# From trimesh's z up to y up, with y of the grid as z.
_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1.0]])


def _extras(vessel: VesselMap, calibration: Calibration, depth_um: float) -> dict[str, Any]:
    return {
        "frame": "x: grid x, y: height over the floor, z: grid y; metres",
        "vessel": vessel.name,
        "m_per_px": vessel.um_per_px * 1e-6,
        "size_px": vessel.size_px,
        "depth_m": depth_um * 1e-6,
        "stage_from_vessel": calibration.stage_from_vessel.rows(),
        "floor_z_um": calibration.floor_z_um,  # at the robot's centre
        "robot_radius_m": vessel.robot_radius_px * vessel.um_per_px * 1e-6,
        "critical_height_um": calibration.critical_height_um,
    }


def _vessel_meshes(vessel: VesselMap, depth_um: float) -> tuple[Any, Any]:
    """Return the walls around the lumen, and the plate that they stand on."""
    import trimesh
    from shapely import Polygon, unary_union

    mask = np.pad(vessel.lumen.astype(np.uint8), 1)
    contours, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    scale = vessel.um_per_px * 1e-6
    rings = [cv2.approxPolyDP(c, _OUTLINE_PX, closed=True)[:, 0, :] - 1 for c in contours]
    lumens = []
    for index, (ring, links) in enumerate(zip(rings, hierarchy[0], strict=True)):
        if links[3] >= 0 or len(ring) < 3:
            continue
        inner = [i for i, other in enumerate(hierarchy[0]) if other[3] == index and len(rings[i]) > 2]
        holes = [rings[i] * scale for i in inner]
        lumens.append(Polygon(ring * scale, holes).buffer(0))
    side_m = vessel.size_px * scale
    block = Polygon([(0, 0), (side_m, 0), (side_m, side_m), (0, side_m)])
    left = block.difference(unary_union(lumens))
    parts = list(left.geoms) if hasattr(left, "geoms") else [left]
    walls = trimesh.util.concatenate(
        [trimesh.creation.extrude_polygon(part, depth_um * 1e-6) for part in parts if part.area > 0]
    )
    walls.apply_transform(_FROM_PLAN)
    plate = trimesh.creation.box((side_m, _PLATE_UM * 1e-6, side_m))
    plate.apply_translation((side_m / 2, -_PLATE_UM * 0.5e-6, side_m / 2))
    return _coloured(walls, "vessel"), _coloured(plate, "plate")


# A plan's x and y become x and z; its height becomes y. The mirroring turns the faces, which is mended.
_FROM_PLAN = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])


def _tool_meshes(tool: ToolShape, calibration: Calibration) -> dict[str, Any]:
    """Return magnet, needle and arm around the magnet's centre, as they lean."""
    import trimesh

    axis = _needle_axis(tool, calibration)
    turn = trimesh.geometry.align_vectors((0.0, 0.0, 1.0), axis)
    magnet_m, needle_m = tool.magnet_length_um * 1e-6, _NEEDLE_UM * 1e-6
    radius_m = tool.magnet_diameter_um * 0.5e-6
    magnet = trimesh.creation.cylinder(radius_m, magnet_m, sections=32)
    needle = trimesh.creation.cylinder(0.45 * radius_m, needle_m, sections=24)
    needle.apply_translation((0.0, 0.0, (magnet_m + needle_m) / 2))
    for mesh in (magnet, needle):
        mesh.apply_transform(turn)
    arm = trimesh.creation.box([side * 1e-6 for side in _ARM_UM])
    top_m = np.array(axis) * (magnet_m / 2 + needle_m)
    away = np.array([axis[0], 0.0, axis[2]])
    away = away / max(float(np.linalg.norm(away)), 1e-9)
    arm.apply_transform(trimesh.geometry.align_vectors((1.0, 0.0, 0.0), away if away.any() else (1.0, 0, 0)))
    arm.apply_translation(top_m + away * _ARM_UM[0] * 0.45e-6)
    meshes = {"magnet": magnet, "needle": needle, "arm": arm}
    return {name: _coloured(mesh, name) for name, mesh in meshes.items()}


def _needle_axis(tool: ToolShape, calibration: Calibration) -> tuple[float, float, float]:
    """Return the direction from the magnet up the needle, in the scene."""
    tilt, azimuth = math.radians(tool.tilt_deg), math.radians(tool.azimuth_deg)
    (a, b, _), (c, d, _) = calibration.stage_from_vessel.rows()
    x_px, y_px = np.linalg.solve([[a, b], [c, d]], [math.cos(azimuth), math.sin(azimuth)])
    size = math.hypot(x_px, y_px)
    return math.sin(tilt) * x_px / size, math.cos(tilt), math.sin(tilt) * y_px / size


def _coloured(mesh: Any, what: str) -> Any:  # noqa: ANN401 - trimesh has no types
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    colour, metal, rough = _LOOKS[what]
    material = PBRMaterial(
        name=what,
        baseColorFactor=[round(255 * part) for part in colour],
        metallicFactor=metal,
        roughnessFactor=rough,
        alphaMode="BLEND" if colour[3] < 1.0 else "OPAQUE",
        doubleSided=colour[3] < 1.0,
    )
    mesh.visual = TextureVisuals(material=material)
    return mesh


def _at(x_m: float, y_m: float, z_m: float) -> Any:  # noqa: ANN401 - a matrix for trimesh
    matrix = np.eye(4)
    matrix[:3, 3] = (x_m, y_m, z_m)
    return matrix
