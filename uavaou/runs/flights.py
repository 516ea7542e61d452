"""The flights of a run in its own folder, and the curves of its training: rows of the table of flights."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from uavaou.algorithms.io.tensor_file import POLICY, ArrayFile
from uavaou.csv_tables import NUMBER, read_table
from uavaou.errors import InputError
from uavaou.evaluation.flights import SAMPLED, TRAINING, VALIDATION, Flights, column
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import EPISODE_COLUMNS, RunConfig, RunFolder
from uavaou.scenario import Scenario

MOST_GROUPS = 200  # of the missions of a training


def own_flights(folder: RunFolder, config: RunConfig, episodes: int) -> Flights | None:
    """The rows of a run's policy in the first ``episodes`` missions of its evaluation; None where they are not there.

    Only flights of the present best checkpoint count, with the action that it was chosen by: ``uavaou eval`` may have
    played another action, or the best policy of an earlier time in the training.

    Raises:
        InputError: there are some, and the checkpoint cannot be read.
    """
    found = Flights.joined([])
    with suppress(InputError):  # damaged: as if it had not been evaluated
        found = Flights.read(folder.path).where(policy=config.algorithm.name, seed=config.seed)
    missions = found.flights
    if list(missions["mission_seed"]) != list(range(EVALUATION_SEED, EVALUATION_SEED + episodes)):
        return None
    if not folder.policy.is_file():
        return None
    checkpoint = ArrayFile(folder.policy)
    present = checkpoint.digest(POLICY), TrainingProgress.read(checkpoint).best_action
    flown = set(zip(missions["digest"], missions["action"], strict=True))
    return found if flown == {present} else None


def keep_flights(folder: RunFolder, rows: Flights) -> str:
    """Write flights into a run's folder, unless it has them of more missions; returns a note on what was done."""
    with suppress(InputError):
        if Flights.read(folder.path).flights["mission_seed"].nunique() > rows.flights["mission_seed"].nunique():
            return f"kept {folder.flights}: it is of more missions"
    try:
        rows.write(folder.path)
    except InputError as problem:  # of a full disk: the figures are still shown
        return str(problem)
    return f"wrote {folder.flights}"


def training_facts(folder: RunFolder, config: RunConfig) -> dict[str, Any]:
    """What is the same in all rows of a training."""
    meta = folder.read_meta()
    best = None if meta.best_score is None else meta.best_score / config.scenario.slot_length_s
    kept = {name: getattr(meta, name) for name in ("slots", "agent_steps", "wall_s", "cpu_s", "commit", "processor")}
    return kept | {"algorithm": config.algorithm.name, "best_slots": best}


def training_curves(folder: RunFolder, scenario: Scenario) -> list[dict[str, Any]]:
    """The training missions of a run in order, in groups of equal size (or one more), and its validations.

    Raises:
        InputError: a file is missing or damaged, or no mission has ended.
    """
    tau = scenario.slot_length_s
    missions = read_table(folder.episodes, dict.fromkeys(EPISODE_COLUMNS, NUMBER), EPISODE_COLUMNS)
    if not len(missions):
        raise InputError(f"{folder.episodes}: no mission has ended yet")
    groups = np.array_split(np.arange(len(missions)), min(MOST_GROUPS, len(missions)))
    ends, means = [group[-1] for group in groups], {"mean_aou_slots": column(missions, "mean_aou_s") / tau}
    means |= {name: column(missions, name) for name in ("communications", "devices_served")}
    curves = [{"curve": TRAINING, "x": column(missions, "slots")[ends], "wall_s": column(missions, "wall_s")[ends]}]
    curves[0] |= {name: np.array([values[group].mean() for group in groups]) for name, values in means.items()}
    for curve, action in ((VALIDATION, "greedy"), (SAMPLED, "sample")) if folder.progress.is_file() else ():
        curves.append({"curve": curve} | _validations(folder, action, tau))
    return curves


def _validations(folder: RunFolder, action: str, tau: float) -> dict[str, Any]:
    """The columns of the curve of the validations with an action."""
    columns = {"x": "time/slots", "wall_s": "time/wall_s", "mean_aou_slots": f"evaluation/mean_aou_{action}_s"}
    columns |= {name: f"evaluation/{name}_{action}" for name in ("communications", "devices_served")}
    table = read_table(folder.progress, dict.fromkeys(columns.values(), NUMBER))  # the last ones may be missing
    table = table[table[columns["mean_aou_slots"]].notna()]
    found = {name: column(table, source) for name, source in columns.items()}
    return found | {"mean_aou_slots": found["mean_aou_slots"] / tau}
