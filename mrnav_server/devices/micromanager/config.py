"""Settings of stages and cameras behind Micro-Manager."""

import math
from dataclasses import dataclass

from mrnav_server.core.errors import ConfigError

DEMO = "demo"
"""Stands for the configuration and the adapters of the package mm-test-adapters."""
_Triple = tuple[float, float, float]
_ALLOWED = {
    "speed_um_per_s": (1.0, 100_000.0),
    "speed_unit_um_per_s": (1e-6, 1e9),
    "poll_hz": (30.0, 200.0),
    "timeout_ms": (20.0, 2000.0),
    "open_timeout_s": (1.0, 600.0),
    "exposure_ms": (0.0, 10_000.0),
}


@dataclass(frozen=True, slots=True)
class MicroManagerConfig:
    """Which devices of a Micro-Manager configuration are used, and how their axes map to the stage frame.

    A device's position d in its own µm is ``scale · d + offset`` in the stage frame, axis by axis.

    Attributes:
        config_file: Configuration file (.cfg) of Micro-Manager; ``"demo"`` is that of mm-test-adapters.
        adapters: Folder with Micro-Manager's device adapters; ``"demo"`` is that of mm-test-adapters.
        xy_stage: Label of the XY stage; "" takes the configuration's default.
        z_stage: Label of the Z (focus) stage; "" takes the configuration's default.
        camera: Label of the camera; "" takes the configuration's default.
        scale_xyz: Stage frame µm per device µm, along x, y, z; usually 1 or -1, never 0.
        offset_um: Where the device's zero lies in the stage frame, x, y, z, in µm.
        travel_min_um: Lower corner of where targets may lie, stage frame x, y, z, in µm.
        travel_max_um: Upper corner of where targets may lie, stage frame x, y, z, in µm.
        xy_speed_properties: Properties of the XY stage that set its speed; none leaves its own speed.
        z_speed_properties: Properties of the Z stage that set its speed; none leaves its own speed.
        speed_um_per_s: What the speed properties are set to at opening, in µm/s, 1..100000.
        speed_unit_um_per_s: Unit of the speed properties, in µm/s; 1000 where they are in mm/s.
        poll_hz: How often the position is read, in Hz, 30..200.
        timeout_ms: How long a call to a stage may take before it counts as silent, in ms, 20..2000.
        open_timeout_s: How long loading may take, homing included, in s, 1..600.
        exposure_ms: Exposure of the camera in ms, up to 10000; 0 leaves the configuration's.

    Raises:
        ConfigError: If one of them is out of its range.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    config_file: str = DEMO
    adapters: str = DEMO
    xy_stage: str = ""
    z_stage: str = ""
    camera: str = ""
    scale_xyz: _Triple = (1.0, 1.0, 1.0)
    offset_um: _Triple = (0.0, 0.0, 0.0)
    travel_min_um: _Triple = (0.0, 0.0, 0.0)
    travel_max_um: _Triple = (20_000.0, 20_000.0, 20_000.0)
    xy_speed_properties: tuple[str, ...] = ()
    z_speed_properties: tuple[str, ...] = ()
    speed_um_per_s: float = 5000.0
    speed_unit_um_per_s: float = 1000.0
    poll_hz: float = 50.0
    timeout_ms: float = 200.0
    open_timeout_s: float = 60.0
    exposure_ms: float = 0.0

    def __post_init__(self) -> None:
        for name, (low, high) in _ALLOWED.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f"micromanager.{name} is {value:g}; choose it within {low:g}..{high:g}")
        for name in ("scale_xyz", "offset_um", "travel_min_um", "travel_max_um"):
            if not all(math.isfinite(value) for value in getattr(self, name)):
                raise ConfigError(f"micromanager.{name} is not finite: give three numbers")
        if 0.0 in self.scale_xyz:
            raise ConfigError("micromanager.scale_xyz has a 0: take 1, or -1 for an axis that runs backwards")
        for axis, low, high in zip("xyz", self.travel_min_um, self.travel_max_um, strict=True):
            if not low < high:
                raise ConfigError(
                    f"micromanager.travel_min_um is not below travel_max_um along {axis} ({low:g}, {high:g})"
                )
