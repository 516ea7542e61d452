"""The policies that come with the package, by name: a folder each in ``zoo_configs/policies``.

Such a folder holds ``config.yaml``, ``policy.safetensors`` and a model card, and is read as the folder of a run.
"""

from pathlib import Path

from uavaou.errors import InputError, nearest_path
from uavaou.zoo import zoo_folder


def released_folder() -> Path:
    """The folder of the released policies."""
    return zoo_folder("policies")


def released_names() -> list[str]:
    """The names of the released policies, sorted."""
    return sorted(path.parent.name for path in released_folder().glob("*/config.yaml"))


def run_path(place: Path | str) -> Path:
    """The folder that a RUN of the command line means.

    Args:
        place: text that is the name of a released policy means that policy, other text and every ``Path`` the folder at
            that path. ``./NAME`` is the folder of that name.

    Raises:
        InputError: the text is empty, which would mean the present folder.
    """
    if place == "":
        raise InputError("RUN is empty: expected a path")
    return released_folder() / place if isinstance(place, str) and place in released_names() else Path(place)


def nearest_released(path: Path) -> str:
    """The hint for a run folder that does not exist: the released policy or the path that its name is near to."""
    if path.name in released_names():
        return f"; the released policy is named without a path: {path.name}"
    return nearest_path(path, released_names())
