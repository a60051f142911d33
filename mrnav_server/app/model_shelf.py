"""The vessel models that pages may choose: made in the page, or shipped with the package."""

from pathlib import Path
from typing import Any

from mrnav_server.core.errors import RefusedError
from mrnav_server.vision.model_store import find_model, model_names


class ModelShelf:
    """Finds models by their names; an own one comes before a shipped one of the same name.

    Args:
        root: Folder that holds one folder per own model.
        in_use: The model in use: a name or a folder, as the settings say.
    """

    def __init__(self, root: Path, in_use: str) -> None:
        self.root = root
        self._in_use = in_use

    def names(self) -> list[str]:
        """Return all names, own models first. Reads the disk."""
        own = self._own()
        return [*own, *(name for name in model_names() if name not in own)]

    def describe(self) -> list[dict[str, Any]]:
        """Describe the models, for JSON. Reads the disk."""
        own, in_use = self._own(), find_model(self._in_use).name
        return [{"name": name, "own": name in own, "in_use": name == in_use} for name in self.names()]

    def setting(self, name: str) -> str:
        """Return what ``rig.vessel`` says to have a model.

        Raises:
            RefusedError: If there is no such model.
        """
        if name not in self.names():
            known = ", ".join(self.names())
            raise RefusedError("no_such_model", f"there is no vessel model {name!r}: name one of {known}")
        return str(self.root / name) if name in self._own() else name

    def _own(self) -> list[str]:
        return sorted(path.parent.name for path in self.root.glob("*/model.json"))
