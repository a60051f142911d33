"""The camera's picture: its size and rate, said once for the camera, the calibration and the twin."""

from dataclasses import dataclass

from mrnav_server.core.errors import ConfigError

_ALLOWED = {"width_px": (64, 8192), "height_px": (64, 8192), "fps": (1.0, 1000.0)}


@dataclass(frozen=True, slots=True)
class PictureFormat:
    """Size and rate of the camera's pictures.

    Attributes:
        width_px: Picture width, 64..8192.
        height_px: Picture height, 64..8192.
        fps: Frames a second, 1..1000.

    Raises:
        ConfigError: If one of them is out of its range.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    width_px: int = 1600
    height_px: int = 1200
    fps: float = 30.0

    def __post_init__(self) -> None:
        for name, (low, high) in _ALLOWED.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f"camera.{name} is {value:g}; choose it within {low:g}..{high:g}")

    @property
    def center_px(self) -> tuple[float, float]:
        """The picture's centre, x and y in image pixels; pixel 0 is centred on 0."""
        return (self.width_px - 1) / 2.0, (self.height_px - 1) / 2.0
