"""The versions, the commit and the machine that a training ran with."""

import os
import platform
import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from uavaou.threads import threads

_PACKAGES = ("uavaou", "torch", "stable-baselines3", "supersuit", "pettingzoo", "gymnasium", "numpy", "numba")
_NUMBERS = {"family": "cpu family", "model": "model"}  # of a processor: its field in /proc/cpuinfo


def describe_machine() -> dict[str, Any]:
    """Versions, commit and machine, the first fields of :class:`~uavaou.runs.folder.RunMeta`."""
    return {
        "versions": {package: installed(package) for package in _PACKAGES},
        "commit": _commit(),
        "python": platform.python_version(),
        "system": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": threads(),
    }


def installed(package: str) -> str | None:
    """The version of a package that is installed."""
    with suppress(PackageNotFoundError):
        return version(package)
    return None


def _commit() -> str | None:
    """The commit of the repository that the package runs from; None for an installed wheel."""
    root = Path(__file__).resolve().parents[2]
    command = ["git", "-C", str(root), "rev-parse", "HEAD"]
    with suppress(OSError, subprocess.CalledProcessError):
        if (root / ".git").exists():
            return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    return None


def _processor() -> str:
    """The name, and where Linux tells them the family and model: some virtual machines hide those in the name."""
    with suppress(OSError):
        first = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n", 1)[0]
        stated = {
            name.strip(): value.strip() for name, _, value in (line.partition(":") for line in first.splitlines())
        }
        if name := stated.get("model name"):
            numbers = " ".join(f"{part} {stated[field]}" for part, field in _NUMBERS.items() if field in stated)
            return f"{name} ({numbers})" if numbers else name
    return platform.processor()
