"""``meta.json`` of a run: versions, machine, budgets, and where the training stands."""

import os
import platform
import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict

from uavaou.fields import Number, Whole

_PACKAGES = ("uavaou", "torch", "stable-baselines3", "supersuit", "pettingzoo", "gymnasium", "numpy")


class RunMeta(BaseModel):
    """The content of ``meta.json``; what follows ``checkpoints`` is a training's progress at its last checkpoint."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    versions: dict[str, str | None] = {}
    commit: str | None = None  # of the repository that the package ran from
    python: str | None = None
    system: str | None = None
    processor: str | None = None
    cores: Whole | None = None
    slots: Whole
    agent_steps: Whole
    slots_budget: Whole | None = None
    finished: bool
    device: str | None = None
    checkpoints: dict[str, Whole | Number] = {}  # written, and the seconds that it took of the wall-clock
    missions: Whole | None = None
    wall_s: Number
    updates: Whole | None = None
    next_evaluation: Whole | None = None
    best_score: Number | None = None  # mean AoU on the validation missions, s
    best_action: str = "greedy"
    rows: Whole | None = None
    row_slots: Whole | None = None
    budget_left: Number | None = None
    cpu_s: Number | None = None


def describe_machine() -> dict[str, Any]:
    """Versions, commit and machine, the first fields of :class:`RunMeta`."""
    return {
        "versions": {package: _version(package) for package in _PACKAGES},
        "commit": _commit(),
        "python": platform.python_version(),
        "system": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
    }


def _version(package: str) -> str | None:
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
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor()
