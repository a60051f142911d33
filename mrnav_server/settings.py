"""All settings in one tree: defaults (the simulated rig) < TOML file < ``MRNAV_SECTION__NAME`` variables.

Each section is a frozen dataclass beside the code that it configures. Whatever is wrong is told at once, in
one error that names every fault, where it stands and what to do.
"""

import dataclasses
import difflib
import hashlib
import ipaddress
import json
import math
import secrets
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import orjson
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from mrnav_server.autonomy.following import FollowerConfig
from mrnav_server.autonomy.path import PathConfig
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.hand import HandConfig
from mrnav_server.core.limits import Limits
from mrnav_server.core.picture import PictureFormat
from mrnav_server.devices.micromanager.config import MicroManagerConfig
from mrnav_server.devices.sensapex.config import SensapexConfig
from mrnav_server.loops.autopilot import AutopilotConfig
from mrnav_server.loops.control import ControlConfig
from mrnav_server.loops.guards import GuardConfig
from mrnav_server.loops.hand_link import HandLinkConfig
from mrnav_server.loops.handover import HandoverConfig
from mrnav_server.loops.recorder import RecorderConfig
from mrnav_server.loops.supervisor import SupervisorConfig
from mrnav_server.loops.trial_marks import TrialConfig
from mrnav_server.loops.video_recorder import VideoConfig
from mrnav_server.sim.microscope import MicroscopeConfig
from mrnav_server.sim.world import SimConfig
from mrnav_server.vision.calibration_plan import CalibrationConfig
from mrnav_server.vision.drift import DriftConfig
from mrnav_server.vision.registration import RegistrationConfig
from mrnav_server.vision.tip import TipLook
from mrnav_server.vision.tip_agreement import TipWatchConfig
from mrnav_server.vision.tracker import TrackerConfig

DEFAULT_FILE = Path("mrnav.toml")
_PREFIX = "MRNAV_"
_Path = tuple[str, ...]
_SECRETS = ("chief_token", "operator_token", "viewer_token")

Port = Annotated[int, Field(ge=0, le=65535)]
Token = Annotated[str, Field(min_length=16, pattern=r"^[A-Za-z0-9_.~-]+$")]


@dataclass(frozen=True, slots=True)
class ServerConfig:
    """Where the server listens and who may come in.

    Attributes:
        host: Address of both ports.
        port: Page, WebSockets, video and REST; 0 takes a free one.
        hand_port: Hand link over TCP; 0 takes a free one.
        operator_token: Lets its bearer control the rig, at least 16 characters; None makes one at start.
        viewer_token: Lets its bearer watch, and stop; None makes one at start.
        chief_token: Lets its bearer take control from another operator too; None: nobody may.
        insecure: Accept that other machines reach the server without TLS.
        origins: Further origins that pages may come from, for example ``"https://lab.example:8443"``.
        tls_certificate: PEM file with the certificate chain; None serves plain HTTP.
        tls_key: PEM file with its private key.
        tls_authority: PEM file with the authority that ``mrnav tls`` made; pages offer it as ``/ca.crt``.
        h264: Send the picture as H.264 to viewers that take it, which needs OpenH264 on this machine; else
            everybody gets JPEG.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    host: str = "127.0.0.1"
    port: Port = 8000
    hand_port: Port = 9000
    operator_token: Token | None = field(default=None, repr=False)
    viewer_token: Token | None = field(default=None, repr=False)
    chief_token: Token | None = field(default=None, repr=False)
    insecure: bool = False
    origins: tuple[str, ...] = ()
    tls_certificate: str | None = None
    tls_key: str | None = None
    tls_authority: str | None = None
    h264: bool = False

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the server."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"


@dataclass(frozen=True, slots=True)
class RigConfig:
    """Which camera, vessel model and calibration.

    Attributes:
        camera: Driver of the camera; ``usb`` is ``/dev/videoN`` with N from ``camera.index``,
            ``micromanager`` the one that section ``micromanager`` names, ``file`` the film ``camera.file``.
        vessel: Name of a vessel model, or a path to its folder.
        calibration: File that `mrnav calibrate run` has written; None is the simulated rig's own.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    camera: Literal["simulated", "usb", "micromanager", "file"] = "simulated"
    vessel: str = "bifurcation"
    calibration: str | None = None


@dataclass(frozen=True, slots=True)
class ManipulatorConfig:
    """Which manipulator.

    Attributes:
        driver: ``sensapex-udp`` and ``sensapex-sdk`` are described by section ``sensapex``,
            ``micromanager`` by the section of that name.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    driver: Literal["simulated", "sensapex-udp", "sensapex-sdk", "micromanager"] = "simulated"


@dataclass(frozen=True, slots=True)
class CameraConfig(PictureFormat):
    """Which camera, and the pictures that it is asked for.

    Attributes:
        index: Number of the USB camera, from 0.
        exposure_ms: Exposure time of the USB camera in ms, up to 1000; 0 is automatic exposure.
        gain: Gain of the USB camera in its own units; None leaves it to the camera.
        file: Video file that camera ``file`` plays.
        loop: Play that file again and again.
    """

    index: Annotated[int, Field(ge=0)] = 0
    exposure_ms: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    gain: Annotated[float, Field(ge=0.0, le=1e6)] | None = None
    file: str = ""
    loop: bool = False


@dataclass(frozen=True, slots=True)
class RecordingConfig(RecorderConfig):
    """Where and how trials are written.

    Attributes:
        root: Folder that gets one folder per trial.
    """

    root: str = "trials"


@dataclass(frozen=True, slots=True)
class ModelsConfig:
    """Where the dashboard keeps what it imports and trains.

    Attributes:
        root: Folder that gets one folder per vessel model.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    root: str = "models"


class Settings(BaseModel):
    """Every setting of a server; immutable. A section is one line here."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    server: ServerConfig = ServerConfig()
    rig: RigConfig = RigConfig()
    manipulator: ManipulatorConfig = ManipulatorConfig()
    sensapex: SensapexConfig = SensapexConfig()
    micromanager: MicroManagerConfig = MicroManagerConfig()
    supervisor: SupervisorConfig = SupervisorConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    camera: CameraConfig = CameraConfig()
    sim: SimConfig = SimConfig()
    microscope: MicroscopeConfig = MicroscopeConfig()
    tracker: TrackerConfig = TrackerConfig()
    registration: RegistrationConfig = RegistrationConfig()
    drift: DriftConfig = DriftConfig()
    tip: TipLook = TipLook()
    tip_watch: TipWatchConfig = TipWatchConfig()
    follower: FollowerConfig = FollowerConfig()
    limits: Limits = Limits()
    hand: HandConfig = HandConfig()
    hand_link: HandLinkConfig = HandLinkConfig()
    control: ControlConfig = ControlConfig()
    handover: HandoverConfig = HandoverConfig()
    path: PathConfig = PathConfig()
    autopilot: AutopilotConfig = AutopilotConfig()
    trial: TrialConfig = TrialConfig()
    guards: GuardConfig = GuardConfig()
    recording: RecordingConfig = RecordingConfig()
    video: VideoConfig = VideoConfig()
    models: ModelsConfig = ModelsConfig()

    def public(self) -> dict[str, Any]:
        """Return the configuration without the tokens, ready for JSON."""
        values = self.model_dump(mode="json")
        for name in _SECRETS:
            del values["server"][name]
        return values

    def digest(self) -> str:
        """Return a hash of the configuration, without the tokens: sha256, 64 hex digits."""
        return hashlib.sha256(orjson.dumps(self.public(), option=orjson.OPT_SORT_KEYS)).hexdigest()

    def with_tokens(self) -> "Settings":
        """Return the settings with a fresh random token for every role that has none."""
        server = dataclasses.replace(
            self.server,
            operator_token=self.server.operator_token or secrets.token_urlsafe(24),
            viewer_token=self.server.viewer_token or secrets.token_urlsafe(24),
        )
        return self.model_copy(update={"server": server})


def load_settings(path: Path | None, env: Mapping[str, str]) -> Settings:
    """Compose the settings.

    Args:
        path: A TOML file that must exist; None reads ``./mrnav.toml`` if there is one.
        env: Environment variables; those that begin with ``MRNAV_`` are settings.

    Raises:
        ConfigError: If anything is wrong; the message names every fault.
    """
    faults: list[str] = []
    file = path or (DEFAULT_FILE if DEFAULT_FILE.is_file() else None)
    values = _read_toml(file, faults) if file else {}
    blame = _Blame(str(file))
    # A file says what it means and is read strictly; a variable is always text and is converted.
    faults += blame.faults(values, strict=True)
    blame.variables = _merge_env(values, env, faults)
    faults += [fault for fault in blame.faults(values, strict=False) if fault not in faults]
    faults += blame.not_finite(values)
    faults += _contradictions(values)
    if not faults:
        return Settings.model_validate(values)
    count = "one fault" if len(faults) == 1 else f"{len(faults)} faults"
    raise ConfigError(f"settings: {count}: " + "; ".join(faults))


def _read_toml(file: Path, faults: list[str]) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        faults.append(f"the file {file} does not exist: create it, or leave --config out")
    except (OSError, UnicodeDecodeError) as error:
        faults.append(f"the file {file} cannot be read ({error})")
    except tomllib.TOMLDecodeError as error:
        faults.append(f"the file {file} is not TOML: {error}")
    return {}


def _merge_env(values: dict[str, Any], env: Mapping[str, str], faults: list[str]) -> dict[_Path, str]:
    """Lay the variables over the file's values; return which variable set which path."""
    names: dict[_Path, str] = {}
    for name in sorted(n for n in env if n.startswith(_PREFIX)):
        path = tuple(name.removeprefix(_PREFIX).lower().split("__"))
        if len(path) < 2 or not all(path):
            faults.append(f"{name}: unknown variable: settings are named {_PREFIX}SECTION__NAME")
            continue
        table = values
        for key in path[:-1]:
            inner = table.setdefault(key, {})
            if not isinstance(inner, dict):
                table[key] = inner = {}
            table = inner
        table[path[-1]] = _parsed(env[name])
        names[path] = name
    return names


def _parsed(text: str) -> object:
    """Return lists and tables parsed as JSON, everything else as it is: the field's type decides."""
    if text.startswith(("[", "{")):
        try:
            parsed: object = json.loads(text)
        except json.JSONDecodeError:
            return text
        return parsed
    return text


class _Blame:
    """Finds what is wrong and says where it stands.

    Args:
        file: Name of the file that was read.
    """

    def __init__(self, file: str) -> None:
        self._file = file
        self._told: set[_Path] = set()
        self.variables: dict[_Path, str] = {}

    def faults(self, values: dict[str, Any], *, strict: bool) -> Iterator[str]:
        """Name every wrong value that was not named before; one bad section hides no other."""
        for section, content in values.items():
            if section not in Settings.model_fields:
                yield from self._once((section,), self._unknown((section,)))
                continue
            kind: Any = Settings.model_fields[section].annotation
            try:
                if strict:
                    TypeAdapter(kind).validate_json(json.dumps(content, default=str), strict=True)
                else:
                    TypeAdapter(kind).validate_python(content)
            except ConfigError as error:
                yield from self._once((section,), f"{self._where((section,))}: {error}")
            except ValidationError as error:
                for item in error.errors(include_url=False, include_context=False):
                    path = (section, *(str(part) for part in item["loc"]))
                    yield from self._once(path, self._fault(path, item["type"], item["msg"], item["input"]))

    def not_finite(self, values: dict[str, Any]) -> Iterator[str]:
        """Name every number that is NaN or infinite: comparing it with a limit may let it through."""
        for path, value in _leaves((), values):
            number = _number(value) if path in self.variables and not _is_text(path) else value
            if isinstance(number, float) and not math.isfinite(number):
                yield f"{self._where(path)} {value}: should be a finite number"

    def _once(self, path: _Path, fault: str) -> Iterator[str]:
        if path not in self._told:
            self._told.add(path)
            yield fault

    def _fault(self, path: _Path, kind: str, message: str, value: object) -> str:
        if kind == "unexpected_keyword_argument":
            return self._unknown(path)
        shown = "" if any(part in _SECRETS for part in path) else f" {value!r}"
        return f"{self._where(path)}{shown}: {message.removeprefix('Value error, ').removeprefix('Input ')}"

    def _unknown(self, path: _Path) -> str:
        names = _names_at(path[:-1])
        near = difflib.get_close_matches(path[-1], names, n=1)
        remedy = f"did you mean {near[0]}?" if near else f"there are {', '.join(names)}"
        return f"{self._where(path)}: unknown setting; {remedy}"

    def _where(self, path: _Path) -> str:
        """Return a setting's name and the variable or file that it comes from."""
        around = [path[:length] for length in range(len(path), 0, -1) if path[:length] in self.variables]
        inside = [other for other in self.variables if other[: len(path)] == path]
        source = self.variables[(around + inside)[0]] if around or inside else self._file
        return f"{'.'.join(path)} ({source})"


def _names_at(path: _Path) -> list[str]:
    """Return the names of the settings in a section; the defaults know them all."""
    section = _default_at(path)
    if isinstance(section, Settings):
        return list(Settings.model_fields)
    return [f.name for f in dataclasses.fields(section)] if dataclasses.is_dataclass(section) else []


def _default_at(path: _Path) -> object:
    value: object = Settings()
    for key in path:
        value = getattr(value, key, None)
    return value


def _leaves(path: _Path, value: object) -> Iterator[tuple[_Path, object]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves((*path, str(key)), inner)
    elif isinstance(value, list | tuple):
        for index, inner in enumerate(value):
            yield from _leaves((*path, str(index)), inner)
    else:
        yield path, value


def _number(value: object) -> object:
    try:
        return float(str(value))
    except ValueError:
        return value


def _is_text(path: _Path) -> bool:
    return isinstance(_default_at(path), str | None)


def _contradictions(values: dict[str, Any]) -> Iterator[str]:
    try:
        server = TypeAdapter(ServerConfig).validate_python(values.get("server", {}))
    except ValidationError:
        return  # told already
    if (server.tls_certificate is None) != (server.tls_key is None):
        yield "server.tls_certificate and server.tls_key belong together: set both or none"
    if not server.is_loopback and server.tls_certificate is None and not server.insecure:
        yield (
            f"server.host {server.host!r} is reachable from other machines and tokens would travel in the "
            "clear: set server.tls_certificate and server.tls_key (`mrnav tls` makes them), or "
            "server.insecure = true"
        )
    if server.port == server.hand_port != 0:
        yield f"server.port and server.hand_port are both {server.port}: choose two ports, or 0 for free ones"
    if server.operator_token is not None and server.operator_token == server.viewer_token:
        yield "server.operator_token and server.viewer_token are equal: choose two"
    if server.chief_token is not None and server.chief_token in (server.operator_token, server.viewer_token):
        yield "server.chief_token equals another token: choose one of its own"
    yield from _film_contradictions(values)
    hand_link = values.get("hand_link", {})
    for name, instead in (("host", "server.host"), ("port", "server.hand_port")):
        if isinstance(hand_link, dict) and name in hand_link:
            yield f"hand_link.{name} follows {instead}: set that instead"


def _film_contradictions(values: dict[str, Any]) -> Iterator[str]:
    if _given(values, "rig", "camera") != "file":
        return
    if not _given(values, "camera", "file"):
        yield 'rig.camera = "file" needs camera.file: name a video file'
    if _given(values, "manipulator", "driver") not in (None, "simulated"):
        yield 'rig.camera = "file" shows no present robot to steer: set manipulator.driver = "simulated"'


def _given(values: dict[str, Any], section: str, name: str) -> object:
    content = values.get(section)
    return content.get(name) if isinstance(content, dict) else None
