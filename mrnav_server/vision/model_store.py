"""Where vessel models lie: ``policies/`` of a checkout, or inside the installed package."""

from pathlib import Path

from mrnav_server.core.errors import ConfigError


def models_root() -> Path:
    """Return the folder that holds one folder per vessel model.

    Raises:
        ConfigError: If there is none.
    """
    package = Path(__file__).resolve().parent.parent
    for root in (package.parent / "policies", package / "policies"):
        if root.is_dir():
            return root
    raise ConfigError(f"no folder of vessel models: neither {package.parent / 'policies'} nor in the package")


def model_names() -> list[str]:
    """Return the names of the models that there are, sorted."""
    return sorted(path.parent.name for path in models_root().glob("*/model.json"))


def find_model(name_or_path: str | Path) -> Path:
    """Return the folder of a model, given by its name or by a path to it.

    Raises:
        ConfigError: If there is no such model; the message lists those that there are.
    """
    for folder in (models_root() / name_or_path, Path(name_or_path)):
        if (folder / "model.json").is_file():
            return folder
    known = ", ".join(model_names()) or "none"
    raise ConfigError(
        f"no vessel model {str(name_or_path)!r}: name one of {known}, or a folder with a model.json"
    )
