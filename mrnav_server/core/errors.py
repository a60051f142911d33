"""The error classes: one class, one reaction (docs/architecture.md)."""


class MrnavError(Exception):
    """Base of every error that this package raises on purpose."""


class ConfigError(MrnavError):
    """A setting, file or port is wrong. Reaction: the CLI prints the message and exits with 2."""


class WireError(MrnavError):
    """A peer sent bytes that break the protocol. Reaction: tell that peer and drop it.

    Args:
        code: Stable machine-readable reason, for example ``"bad_version"``.
        message: One sentence for a person.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class RefusedError(MrnavError):
    """A valid request that the present state forbids. Reaction: HTTP 409 with the reason.

    Args:
        code: Stable machine-readable reason, for example ``"no_lease"``.
        message: One sentence for a person, with the remedy.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class DeviceError(MrnavError):
    """A device fails. Reaction: a manipulator ends in FAULT, a camera is reopened with back-off."""


class DeviceTimeoutError(DeviceError, TimeoutError):
    """A device did not answer in time."""
