"""The state of the deciders as JSON, and back, exactly: with it a recording can begin at any moment.

What a decider is built from (settings, vessel, calibration, devices, callables) is no state: it is left out,
and whoever restores builds the deciders first and lays the image over them.
"""

import math
from ast import literal_eval
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import import_module
from types import BuiltinMethodType, FunctionType, MethodType
from typing import Any, cast

import numpy as np

from mrnav_server.autonomy.direct import ActionConfig
from mrnav_server.autonomy.grid_graph import DistanceField
from mrnav_server.autonomy.plane import Plane
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Calibration
from mrnav_server.core.hand_path import PathBounds
from mrnav_server.core.lease import Lease
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.timing import RollingLatency

_PACKAGE = __name__.partition(".")[0]
_DECIDING = tuple(f"{_PACKAGE}.{layer}." for layer in ("core", "autonomy", "loops"))
_BUILT = (ActionConfig, Calibration, Lease, PathBounds, Plane, RollingLatency, VesselMap)
"""Made from settings, or of no weight in a decision; beside every section of the settings."""


def state_image(root: object) -> object:
    """Return everything that an object's next decisions depend on, ready for JSON.

    Raises:
        TypeError: If it holds something that is not known here, naming its class.
    """
    return _Drawing().drawn_object(root)


def restored(image: object, parts: Iterable[object] = (), root: object = None) -> Any:  # noqa: ANN401 - as drawn
    """Return the object of an image.

    Args:
        image: As ``state_image`` returned it.
        parts: What the image's objects were built from: settings' sections, vessel, calibration.
        root: An object of the image's class that was built anew: the image is laid over it.

    Raises:
        ConfigError: If the image is of another version's classes.
    """
    restoring = _Restoring({_name(type(part)): part for part in parts})
    try:
        return restoring.read(image, root)
    except (AttributeError, KeyError, TypeError, ValueError, ImportError) as error:
        raise ConfigError(f"the recorded state is of another version of this software ({error!r})") from None


class _Drawing:
    """Draws one image; an object that was met before is named by its number."""

    def __init__(self) -> None:
        self._met: dict[int, int] = {}
        # Whatever was met stays alive until the image is drawn: another object might get its id.
        self._alive: list[object] = []

    def drawn(self, value: Any) -> object:  # noqa: ANN401 - anything that a decider may hold
        match value:
            case Enum():
                return {"enum": _name(type(value)), "name": value.name}
            case np.generic():
                return self.drawn(value.item())
            case None | bool() | int() | str():
                return value
            case float():
                return value if math.isfinite(value) else {"float": str(value)}
            case complex():
                return {"complex": [self.drawn(value.real), self.drawn(value.imag)]}
            case Counter():
                return {"counter": dict(value)}
            case dict():
                return {"dict": [[self.drawn(key), self.drawn(each)] for key, each in value.items()]}
            case list():
                return [self.drawn(each) for each in value]
            case tuple():
                return {"tuple": [self.drawn(each) for each in value]}
            case set() | frozenset():
                return {"set": [self.drawn(each) for each in sorted(value)]}
            case deque():
                return {"deque": [self.drawn(each) for each in value], "maxlen": value.maxlen}
            case np.ndarray():
                flat = [self.drawn(each) for each in value.ravel().tolist()]
                return {"array": flat, "shape": list(value.shape), "dtype": value.dtype.str}
            case np.random.Generator():
                return {"random": repr(value.bit_generator.state)}
            case DistanceField():
                # As large as the vessel; it serves one task, and no trial that begins in one is replayed.
                return None
            case _ if _is_built(value):
                return {"built": _name(type(value))}
            case _:
                return self.drawn_object(value)

    def drawn_object(self, value: object) -> object:
        if id(value) in self._met:
            return {"same": self._met[id(value)]}
        self._met[id(value)] = len(self._met)
        self._alive.append(value)
        return {
            "object": _name(type(value)),
            "fields": {name: self.drawn(each) for name, each in _fields(value).items() if not _calls(each)},
        }


class _Restoring:
    """Reads one image."""

    def __init__(self, parts: Mapping[str, object]) -> None:
        self._parts = parts
        self._met: list[object] = []

    def read(self, image: Any, current: object = None) -> Any:  # noqa: ANN401 - as drawn
        if isinstance(image, list):
            return [self.read(each) for each in image]
        if not isinstance(image, dict):
            return image
        match next(iter(image)):
            case "object":
                return self._read_object(image, current)
            case "same":
                return self._met[image["same"]]
            case "built":
                return current if current is not None else self._parts[image["built"]]
            case "enum":
                return cast(type[Enum], _class(image["enum"]))[image["name"]]
            case "float":
                return float(image["float"])
            case "complex":
                return complex(*(self.read(each) for each in image["complex"]))
            case "counter":
                return Counter(image["counter"])
            case "dict":
                return {self.read(key): self.read(each) for key, each in image["dict"]}
            case "tuple":
                return tuple(self.read(each) for each in image["tuple"])
            case "set":
                return {self.read(each) for each in image["set"]}
            case "deque":
                return deque((self.read(each) for each in image["deque"]), image["maxlen"])
            case "array":
                flat = [self.read(each) for each in image["array"]]
                return np.array(flat, np.dtype(image["dtype"])).reshape(image["shape"])
            case "random":
                return _generator(image["random"])
            case unknown:
                raise KeyError(unknown)

    def _read_object(self, image: Mapping[str, Any], current: object) -> object:
        kind = _class(image["object"])
        frozen = is_dataclass(kind) and kind.__dataclass_params__.frozen  # type: ignore[attr-defined]
        value = current if type(current) is kind and not frozen else object.__new__(kind)
        self._met.append(value)
        for name, each in image["fields"].items():
            object.__setattr__(value, name, self.read(each, getattr(value, name, None)))
        return value


def _fields(value: object) -> dict[str, object]:
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    return dict(sorted(vars(value).items()))


def _calls(value: object) -> bool:
    """Tell whether a value is a callable that somebody else gave."""
    return isinstance(value, FunctionType | MethodType | BuiltinMethodType)


def _is_built(value: object) -> bool:
    kind = type(value)
    deciding = kind.__module__.startswith(_DECIDING)
    return not deciding or isinstance(value, _BUILT) or hasattr(kind, "__pydantic_config__")


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _class(name: str) -> type:
    """Return a class of this package, and nothing else: a recording may come from anywhere."""
    module, _, qualname = name.partition(":")
    if not module.startswith(f"{_PACKAGE}."):
        raise KeyError(name)
    kind = getattr(import_module(module), qualname)
    if not isinstance(kind, type):
        raise KeyError(name)
    return kind


def _generator(state: str) -> np.random.Generator:
    generator = np.random.default_rng()
    generator.bit_generator.state = literal_eval(state)
    return generator
