"""What a run's folder holds, read and checked for the figures."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.errors import InputError
from uavaou.files import read_json, read_text
from uavaou.reports import style
from uavaou.zoo import read_yaml_mapping

Floats = NDArray[np.float64]

EPISODE_COLUMNS = ("slots", "wall_s", "reward_s", "mean_aou_s", "communications", "devices_served")
_MOST_BYTES = 1_000_000_000  # of episodes.csv: some billion slots
_LEARNED_NAMES = ("policy", "model", "learned")  # what an evaluation may call the run's own policy


@dataclass(frozen=True)
class PolicyResult:
    """What one policy did in the missions of one evaluation; None where the file does not say."""

    mean_aou_s: Floats  # (n,) s
    communications: Floats  # (n,)
    devices_served: Floats  # (n,)
    update_period: Floats | None  # (I,) slots, k_i
    device_communications: Floats | None  # (n, I)
    aou_over_time: Floats | None  # (K,) s, mean over the missions
    aou_over_time_low: Floats | None  # (K,) s
    aou_over_time_high: Floats | None  # (K,) s


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
        evaluations={path.stem: found for path, found in _evaluations(folder, name) if found is not None},
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


def _evaluations(folder: Path, algorithm: str) -> Iterator[tuple[Path, dict[str, PolicyResult] | None]]:
    for path in sorted(folder.glob("eval/*.json")):
        yield path, _read_evaluation(path, algorithm)


def _read_evaluation(path: Path, algorithm: str) -> dict[str, PolicyResult] | None:
    """The policies of an evaluation; None for a suite, unless its one point is what the run was trained for."""
    content = read_json(path)
    if isinstance(content, dict) and "points" in content:
        points = content["points"]
        whole = isinstance(points, list) and len(points) == 1 and isinstance(points[0], dict)
        if not whole or "trained" not in dict(points[0].get("how") or {}).values():
            return None
        content = points[0]
    policies = content.get("policies") if isinstance(content, dict) else None
    if not isinstance(policies, dict):
        raise InputError(f"{path}: field 'policies' is missing or not a mapping")
    base = style.base_name(algorithm)
    own = {algorithm, base, *_LEARNED_NAMES}
    return {
        algorithm if name in own else name: _read_policy(f"{path}: policy '{name}'", entry)
        for name, entry in policies.items()
    }


def _read_policy(where: str, entry: Any) -> PolicyResult:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected a mapping")
    for field in ("mean_aou_s", "communications", "devices_served"):
        if field not in entry:
            raise InputError(f"{where}: field '{field}' is missing")
    number = partial(_numbers, where, entry)
    result = PolicyResult(
        mean_aou_s=_given(number("mean_aou_s")),
        communications=_given(number("communications")),
        devices_served=_given(number("devices_served")),
        update_period=number("update_period_slots"),
        device_communications=number("device_communications", 2),
        aou_over_time=number("aou_over_time_s"),
        aou_over_time_low=number("aou_over_time_low_s"),
        aou_over_time_high=number("aou_over_time_high_s"),
    )
    period, counts = result.update_period, result.device_communications
    if period is not None and counts is not None and counts.shape[1] != len(period):
        raise InputError(
            f"{where}: field 'device_communications' has {counts.shape[1]} devices, "
            f"'update_period_slots' has {len(period)}"
        )
    return result


def _given(values: Floats | None) -> Floats:
    assert values is not None  # its presence has been checked
    return values


def _numbers(where: str, entry: dict[str, Any], field: str, dimensions: int = 1) -> Floats | None:
    if entry.get(field) is None:
        return None
    try:
        values = np.asarray(entry[field], dtype=np.float64)
    except (ValueError, TypeError):
        values = np.empty(0)
    if values.ndim != dimensions or values.size == 0 or not np.isfinite(values).all():
        kind = "list of numbers" if dimensions == 1 else "table of numbers"
        raise InputError(f"{where}: field '{field}' is not a {kind}")
    return values
