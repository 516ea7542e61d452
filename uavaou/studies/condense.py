"""The rows that a finished run, a planner or a bound adds to a study's tables, six digits each."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.errors import InputError
from uavaou.files import read_json, read_text
from uavaou.runs.folder import RunFolder
from uavaou.runs.results import PolicyResult
from uavaou.scenario import Scenario
from uavaou.statistics import interval_over_missions
from uavaou.studies.jobs import Key

Rows = dict[str, list[list[str]]]  # table -> rows
MOST_GROUPS = 200  # of a learning curve
_MOST_BYTES = 1_000_000_000
_CURVE = ("reward_s", "mean_aou_s", "communications", "devices_served")


def run_rows(key: Key, algorithm: str, scenario: Scenario, folder: RunFolder, evaluation: PolicyResult) -> Rows:
    """The rows of a finished training.

    Args:
        key: its place in the study.
        algorithm: its name.
        scenario: that it was trained and evaluated on.
        folder: its run folder.
        evaluation: the policy's part of its evaluation file.

    Raises:
        InputError: a file of the run is missing or damaged.
    """
    rows = evaluation_rows(key, scenario, evaluation, str(folder.path))
    rows["curves"] = _curve_rows(key, scenario, folder.episodes)
    rows["validation"] = _validation_rows(key, scenario, folder.path / "progress.csv")
    rows["runs"] = [_run_row(key, algorithm, scenario, folder, evaluation)]
    return rows


def evaluation_rows(key: Key, scenario: Scenario, evaluation: PolicyResult, source: str) -> Rows:
    """The rows of a final evaluation: missions, slots and devices.

    The reward of a mission is the sum over slots of r[t] = -sum_i sum_n A_i^n[t], which is -K times its mean AoU.

    Raises:
        InputError: the evaluation, of ``source``, lacks something.
    """
    tau, place = scenario.slot_length_s, _place(key)
    try:
        aou_s = np.asarray(evaluation.mean_aou_s, dtype=np.float64)  # (n,)
        columns = aou_s / tau, -scenario.slots * aou_s, evaluation.communications, evaluation.devices_served
        missions = [[*place, str(mission), *map(number, row)] for mission, row in enumerate(zip(*columns, strict=True))]
        over_time = np.asarray(evaluation.aou_over_time_s, dtype=np.float64) / tau  # (K,)
        execution = [[*place, str(slot), number(value)] for slot, value in enumerate(over_time, start=1)]
        return {
            "missions": missions, "execution": execution, "devices": _device_rows(place, scenario, evaluation),
        }  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{source}: its evaluation cannot be used ({error!r}): evaluate it again") from error


def _device_rows(place: list[str], scenario: Scenario, evaluation: PolicyResult) -> list[list[str]]:
    """None where each mission draws a new layout: a device is then nowhere in particular."""
    if scenario.layout == "resample":
        return []
    layout = scenario.draw_layout()
    communications = np.asarray(evaluation.device_communications, dtype=np.float64).mean(axis=0)  # (I,)
    aou = np.asarray(evaluation.device_mean_aou_s, dtype=np.float64) / scenario.slot_length_s  # (I,)
    columns = zip(*layout.positions.T, layout.update_period, communications, aou, strict=True)
    return [[*place, str(device), *map(number, row)] for device, row in enumerate(columns)]


def bound_rows(key: Key, scenario: Scenario, found: Mapping[str, Any]) -> Rows:
    """The row of a bound."""
    return {"bounds": [[key.scenario, number(found["bound_s"] / scenario.slot_length_s), str(found["method"])]]}


def _curve_rows(key: Key, scenario: Scenario, path: Path) -> list[list[str]]:
    """The training missions in order, averaged in groups of the same size (or one more)."""
    columns = ("slots", "wall_s", *_CURVE)
    table = _columns(path, columns)  # (M,) each
    missions = len(table["slots"])
    if not missions:
        raise InputError(f"{path}: holds no mission")
    rows = []
    for group in np.array_split(np.arange(missions), min(MOST_GROUPS, missions)):
        means = {name: table[name][group].mean() for name in _CURVE}
        means["mean_aou_s"] /= scenario.slot_length_s
        ends = table["slots"][group[-1]], table["wall_s"][group[-1]]
        rows.append([*_place(key), str(int(ends[0])), number(ends[1]), *(number(means[name]) for name in _CURVE)])
    return rows


def _validation_rows(key: Key, scenario: Scenario, path: Path) -> list[list[str]]:
    greedy, sampled = "evaluation/mean_aou_greedy_s", "evaluation/mean_aou_sample_s"
    table = _columns(path, ("time/slots", "time/wall_s", greedy, sampled), needed=greedy)
    tau, rows = scenario.slot_length_s, []
    for slots, wall_s, *aou_s in zip(*table.values(), strict=True):
        rows.append([*_place(key), str(int(slots)), number(wall_s), *(number(value / tau) for value in aou_s)])
    return rows


def _run_row(key: Key, algorithm: str, scenario: Scenario, folder: RunFolder, evaluation: PolicyResult) -> list[str]:
    meta, tau = read_json(folder.meta), scenario.slot_length_s
    try:
        found = interval_over_missions(evaluation.mean_aou_s / tau)
        best = None if meta.get("best_score") is None else meta["best_score"] / tau
        measured = meta["wall_s"], meta.get("cpu_s"), best, found.value, found.low, found.high
        counts = int(meta["slots"]), int(meta["agent_steps"]), sum(evaluation.violations.values())
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{folder.meta}: cannot be used ({error!r})") from error
    steps = [str(counts[0]), str(counts[1])]
    commit = str(meta.get("commit") or "")
    return [key.variant, algorithm, key.scenario, str(key.seed), *steps, *map(number, measured), str(counts[2]), commit]


def _place(key: Key) -> list[str]:
    return [key.variant, key.scenario, "" if key.seed is None else str(key.seed)]


def number(value: float | None) -> str:
    """Six significant digits, whole numbers whole; empty where there is none."""
    if value is None or math.isnan(value):
        return ""
    value = float(value)
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else f"{value:.6g}"


def _columns(path: Path, names: Sequence[str], needed: str | None = None) -> dict[str, NDArray[np.float64]]:
    """Columns of a run's CSV file, (rows,) each; of the rows where ``needed`` is not empty."""
    reader = csv.DictReader(io.StringIO(read_text(path, _MOST_BYTES), newline=""))
    for name in names:
        if name not in (reader.fieldnames or ()):
            raise InputError(f"{path}: column '{name}' is missing")
    rows: Iterable[dict[str, str]] = (row for row in reader if needed is None or row[needed])
    try:
        table = np.array([[float(row[name]) for name in names] for row in rows]).reshape(-1, len(names))
    except (ValueError, TypeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be used: {error}") from error
    return dict(zip(names, table.T, strict=True))
