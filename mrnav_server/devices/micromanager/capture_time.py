"""When a picture was taken, on the monotonic clock."""


class CaptureTime:
    """Places pictures between the moments at which the buffer was looked into.

    A picture came after the buffer was last seen empty and before it was seen filled; that alone bounds its
    time to a few milliseconds. Within these bounds the camera's own clock decides, where its adapter tells
    it: pictures that piled up while this process was stalled are then told apart. Its zero is taken from the
    picture that came fastest. Half the exposure goes off, since light was gathered until then.

    Args:
        exposure_s: Exposure in seconds.
    """

    def __init__(self, exposure_s: float) -> None:
        self._half_exposure_s = exposure_s / 2.0
        self._zero_s: float | None = None

    def taken_s(self, empty_s: float, filled_s: float, elapsed_s: float | None) -> float:
        """Return the middle of the exposure, monotonic, in seconds; late by the read-out, which nobody tells.

        Args:
            empty_s: When the buffer was last known to be without this picture, monotonic, in seconds.
            filled_s: When it was seen with this picture, monotonic, in seconds.
            elapsed_s: The camera's own time of this picture, in seconds from any zero; None without one.
        """
        arrived_s = empty_s
        if elapsed_s is not None:
            zero_s = filled_s - elapsed_s
            self._zero_s = zero_s if self._zero_s is None else min(self._zero_s, zero_s)
            arrived_s = min(max(self._zero_s + elapsed_s, empty_s), filled_s)
        return arrived_s - self._half_exposure_s
