"""``uavaou doctor``: what this installation has, what it lacks, and the line that mends it."""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires
from itertools import chain
from pathlib import Path

from uavaou_cli.tables import aligned, show, wrapped

# What each extra of pyproject.toml is for, but those for work on uavaou itself.
EXTRAS = {
    "field": "maps and tables of sensors with coordinates",
    "onnx": "export --format onnx",
    "link": "an aircraft over MAVLink",
    "video": "replay --format mp4",
    "tune": "tune",
    "ray": "study run --engine ray",
    "contrib": "learners of sb3-contrib",
    "torchrl": "learners of TorchRL",
}


def doctor() -> None:
    """Show versions, threads and caches, and what is missing for which extra.

    Each thing that is missing has the line to type. A report of a bug holds all of this.
    """
    for part in (_versions, _threads, _caches, _extras):
        show([*part(), ""])  # at once: what comes after it may not load
    show(_verdict())


def _versions() -> list[str]:
    import uavaou
    from uavaou.runs.machine import describe_machine

    machine = describe_machine()
    packages = machine["versions"] | {"uavaou": uavaou.__version__}
    return [
        *wrapped(", ".join(f"{name} {found or '(missing)'}" for name, found in packages.items())),
        f"Python {machine['python']}, {machine['system']}",
        f"uavaou is in {Path(uavaou.__file__).parent}",
    ]


def _threads() -> list[str]:
    from uavaou.threads import threads

    asked = os.environ.get("OMP_NUM_THREADS")
    reason = f" (OMP_NUM_THREADS={asked})" if asked else ""
    return [f"threads: {threads()} of {os.cpu_count()} cores{reason}; for fewer: uavaou train --threads N"]


def _caches() -> list[str]:
    """Where compiled code and fonts are kept between commands, and how large they are."""
    rows, mends = [("cache", "MB", "folder")], []
    for name, place, files, variable in (
        ("compiled code", _compiled_code, "*.nb[ic]", "NUMBA_CACHE_DIR"),
        ("fonts", _fonts, "*.json", "MPLCONFIGDIR"),
    ):
        try:
            folder = place()
        except Exception as error:
            rows.append((name, "", f"unknown, as its package does not load: {error}"))
            continue
        if folder is None:
            mends.append(f"  export {variable}=FOLDER")
        size = sum(path.stat().st_size for path in folder.rglob(files)) if folder else 0
        rows.append((name, f"{size / 1e6:.1f}", str(folder or "none can be written, so each command makes it anew:")))
    return aligned(rows) + mends


def _compiled_code() -> Path | None:
    """Above the folders where Numba has found that it can keep machine code of ours."""
    import uavaou
    from uavaou.world.channel import random_bits

    kept = random_bits.stats.cache_path  # type: ignore[attr-defined]
    package = Path(uavaou.__file__).parent
    if not kept:
        return None
    return package if Path(kept).is_relative_to(package) else Path(kept).parent


def _fonts() -> Path | None:
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # else it complains of the folder in its own words
    import matplotlib

    folder = Path(matplotlib.get_cachedir())
    return None if folder.parent == Path(tempfile.gettempdir()) and "MPLCONFIGDIR" not in os.environ else folder


def _extras() -> list[str]:
    rows, lacking = [("extra", "for", "to have it")], []
    for extra, purpose in EXTRAS.items():
        lacks = list(_lacking(extra))
        rows.append((extra, purpose, f"pip install 'uavaou[{extra}]'" if lacks else "is there"))
        lacking += wrapped(f"{extra} lacks {', '.join(lacks)}", indent="  ") if lacks else []
    return [*aligned(rows, left=3), *lacking]


def _verdict() -> list[str]:
    """Whether what every command needs is there, and can be loaded."""
    if not _needs():
        return ["uavaou runs from a folder that is not installed. To have what it needs:", "  pip install FOLDER"]
    if lacking := [f"'{name}'" for name in _lacking()]:
        return ["Packages are missing or do not fit. To have them:", f"  pip install {' '.join(lacking)}"]
    try:
        import_module("uavaou.runs.train")
    except Exception as error:  # such as a library of torch that does not fit the machine
        return wrapped(f"The packages are there, but training does not load: {type(error).__name__}: {error}")
    return ["What every command needs is there, and training loads."]


def _needs() -> list[str]:
    with suppress(PackageNotFoundError):
        return requires("uavaou") or []
    return []


def _lacking(extra: str = "") -> Iterator[str]:
    """What the package asks for, in any case or for an extra, and is not there in a version that fits."""
    from packaging.requirements import Requirement

    from uavaou.runs.machine import installed

    for needed in map(Requirement, _needs()):
        always, asked = (needed.marker is None or needed.marker.evaluate({"extra": name}) for name in ("", extra))
        if not asked or (extra and always):
            continue
        if needed.name == "uavaou":
            yield from chain.from_iterable(map(_lacking, sorted(needed.extras)))
        elif not needed.specifier.contains(installed(needed.name) or "", prereleases=True):
            yield f"{needed.name}{needed.specifier}"
