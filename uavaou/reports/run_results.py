"""What a run's folder holds, read and checked for the figures."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.errors import InputError
from uavaou.files import read_text
from uavaou.reports import style
from uavaou.runs.folder import RunFolder
from uavaou.runs.results import PolicyResult, read_evaluations
from uavaou.zoo import read_yaml_mapping

Floats = NDArray[np.float64]

EPISODE_COLUMNS = ("slots", "wall_s", "reward_s", "mean_aou_s", "communications", "devices_served")
_MOST_BYTES = 1_000_000_000  # of episodes.csv: some billion slots
_LEARNED_NAMES = ("policy", "model", "learned")  # what an evaluation may call the run's own policy


@dataclass(frozen=True)
class Run:
    """One training run: a row for each mission, and what its policy did when evaluated."""

    scenario: str
    algorithm: str
    episodes: dict[str, Floats]  # EPISODE_COLUMNS, (M,) each
    mission_slots: float  # K
    slot_length_s: float | None
    devices: int | None
    evaluations: dict[str, dict[str, PolicyResult]]  # suite -> policy -> result


def read_run(folder: Path) -> Run:
    """Read ``<scenario>/<algorithm>/seed-<n>``.

    Raises:
        InputError: a file is missing or malformed; the message names the file and the column or field.
    """
    folder = Path(folder)
    episodes = _read_episodes(folder / "episodes.csv")
    config = read_yaml_mapping(folder / "config.yaml") if (folder / "config.yaml").exists() else {}
    scenario, algorithm = (config.get(key) for key in ("scenario", "algorithm"))
    stated: dict[str, Any] = scenario if isinstance(scenario, dict) else {}
    name = _name(algorithm, folder.parent.name)
    return Run(
        scenario=_name(scenario, folder.parent.parent.name),
        algorithm=name,
        episodes=episodes,
        mission_slots=float(stated.get("slots", episodes["slots"][-1] / len(episodes["slots"]))),
        slot_length_s=float(stated["slot_length_s"]) if "slot_length_s" in stated else None,
        devices=int(stated["devices"]) if "devices" in stated else None,
        evaluations=_evaluations(folder, name),
    )


def _name(stated: Any, folder_name: str) -> str:
    """The name in the config; the folder's where that is the same with overrides, which belong to it."""
    name = stated.get("name") if isinstance(stated, dict) else stated
    if not isinstance(name, str) or folder_name.split("+", 1)[0] == name:
        return folder_name
    return name


def _read_episodes(path: Path) -> dict[str, Floats]:
    """The columns of ``episodes.csv``, (M,) each."""
    lines = read_text(path, _MOST_BYTES).split("\n")[
        :-1
    ]  # a run stopped while it wrote leaves a last line without an end
    rows = list(csv.reader(lines))
    header = [cell.strip() for cell in rows[0]] if rows else []
    for column in EPISODE_COLUMNS:
        if column not in header:
            raise InputError(f"{path}: column '{column}' is missing")
    if len(rows) < 2:
        raise InputError(f"{path}: column 'slots' is empty: no mission has ended yet")
    return {column: _read_column(path, rows, header.index(column), column) for column in EPISODE_COLUMNS}


def _read_column(path: Path, rows: list[list[str]], place: int, column: str) -> Floats:
    values = np.empty(len(rows) - 1)
    for line, row in enumerate(rows[1:], start=2):
        cell = row[place] if place < len(row) else ""
        try:
            values[line - 2] = float(cell)
        except ValueError:
            values[line - 2] = np.nan
        if not np.isfinite(values[line - 2]):
            raise InputError(f"{path}: line {line}, column '{column}': '{cell}' is not a finite number")
    return values


def _evaluations(folder: Path, algorithm: str) -> dict[str, dict[str, PolicyResult]]:
    """Evaluation -> policy -> result; the run's own policy under the algorithm's name."""
    own = {style.base_name(algorithm), *_LEARNED_NAMES}
    return {
        evaluation: {algorithm if name in own else name: result for name, result in policies.items()}
        for evaluation, policies in read_evaluations(RunFolder(folder)).items()
    }
