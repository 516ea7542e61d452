"""Condenses what a study has produced: run folders and evaluations become rows of the study's tables."""

from contextlib import suppress
from pathlib import Path

import numpy as np

from uavaou.csv_tables import number, read_csv
from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.runs.folder import RunFolder
from uavaou.runs.results import PolicyResult, find_evaluation
from uavaou.scenario import Scenario
from uavaou.statistics import interval_over_missions
from uavaou.studies.best import keep_best
from uavaou.studies.folder import PLANNED, PartKey, StudyFolder
from uavaou.studies.results import Rows, StudyResults, read_begun
from uavaou.studies.study import Study, StudyRun

MOST_GROUPS = 200  # of a learning curve
VALIDATION_COLUMNS = ("time/slots", "time/wall_s", "evaluation/mean_aou_greedy_s", "evaluation/mean_aou_sample_s")
_CURVE = ("reward_s", "mean_aou_s", "communications", "devices_served")
_VALIDATED_CURVE = (
    "evaluation/reward_sample_s", "evaluation/mean_aou_sample_s", "evaluation/communications_sample",
    "evaluation/devices_served_sample",
)  # fmt: skip


# -- a study -------------------------------------------------------------------------------------------


def gather(study: Study, out: Path) -> tuple[StudyResults, dict[PartKey, str]]:
    """Read the condensed results and the finished runs below ``out``; writes nothing.

    Returns:
        The results, and why run folders could not be read.

    Raises:
        InputError: the results are those of another study, or damaged.
    """
    results, problems = read_begun(StudyFolder.of(out, study.name)), {}
    refuse_another(study, results)
    for run in study.runs():
        try:
            condense_run(results, study, out, run)
        except InputError as problem:
            problems[run.key] = str(problem)
    return results, problems


def update_results(study: Study, out: Path) -> tuple[StudyResults, dict[PartKey, str]]:
    """:func:`gather`, and write the results; parts whose run folders are elsewhere keep their rows."""
    results, problems = gather(study, out)
    results.write(study)
    keep_best(results, study, out)
    return results, problems


def refuse_another(study: Study, results: StudyResults) -> None:
    """Refuse results that are not this study's.

    Raises:
        InputError: naming what differs, and what to do.
    """
    if not results.parts:
        return
    where = f"'{results.folder.path}' holds results of"
    advice = "give the study's file another name, or another --out"
    held = results.settings
    for name, value in (("episodes", study.episodes), ("evaluation_seed", EVALUATION_SEED)):
        if held.get(name) != value:
            raise InputError(f"{where} evaluations with {name} = {held.get(name)!r}, not {value}: {advice}")
    stated, wanted = held.get("planning_seconds"), study.planning_seconds
    if stated is not None and stated != wanted and any(key.variant in PLANNED for key in results.parts):
        raise InputError(f"{where} planners with planning_seconds = {stated!r}, not {wanted!r}: {advice}")
    configs = {run.key: run.config for run in study.runs()}
    planner_parts, scenarios = set(study.planner_parts()), held.get("scenarios") or {}
    for key in results.parts:
        if key in configs:
            if not results.folder.config(key).is_file() or results.folder.read_config(key) != configs[key]:
                raise InputError(f"{where} {key.variant} on {key.scenario} with other settings: {advice}")
        elif key not in planner_parts:
            raise InputError(f"{where} {key}, which the study lacks: {advice}")
        elif scenarios.get(key.scenario) != study.scenarios[key.scenario].to_dict():
            raise InputError(f"{where} {key.variant} on another scenario of the name {key.scenario}: {advice}")


# -- a training ----------------------------------------------------------------------------------------


def trained_so_far(folder: RunFolder) -> tuple[int, float]:
    """How far a run's training is, while it may be writing: slots, and slots a second; 0 where there is nothing.

    The slots are those of the last finished mission or of the last checkpoint.
    """
    slots, rate = 0, 0.0
    with suppress(OSError, ValueError, IndexError, ZeroDivisionError), folder.episodes.open("rb") as file:
        file.seek(max(file.seek(0, 2) - 4096, 0))
        lines = file.read().decode("utf-8", "replace").split("\n")
        _, trained, wall_s, *_ = lines[-2].split(",")  # the last line is incomplete, or empty
        slots, rate = int(trained), int(trained) / float(wall_s)
    with suppress(InputError):
        slots = max(slots, folder.read_meta().slots)
    return slots, rate


def is_trained(folder: RunFolder, run: StudyRun) -> bool:
    """Whether a run folder holds this training, finished.

    Raises:
        InputError: the folder holds another run.
    """
    if not folder.exists():
        return False
    if folder.read_config() != run.config:
        raise InputError(f"'{folder.path}' holds a run with another configuration (see its config.yaml)")
    return folder.finished


def condense_run(results: StudyResults, study: Study, out: Path, run: StudyRun) -> bool:
    """Add a training's rows to the results; False where it has not been trained and evaluated to the end.

    Raises:
        InputError: the folder holds another run, or a file of it is damaged.
    """
    folder, name = study.folder(out, run), run.config.algorithm.name
    evaluation = find_evaluation(folder, name, study.episodes) if is_trained(folder, run) else None
    if evaluation is None:
        return False
    scenario = run.config.scenario
    rows = evaluation_rows(run.key, scenario, evaluation, str(folder.path))
    rows["curves"] = curve_rows(run.key, scenario, folder.episodes)
    rows["validation"] = validation_rows(run.key, scenario, folder.progress)
    meta, tau = folder.read_meta(), scenario.slot_length_s
    found = interval_over_missions(evaluation.mean_aou_s / tau)
    best = None if meta.best_score is None else meta.best_score / tau
    measured = map(number, (meta.wall_s, meta.cpu_s, best, found.value, found.low, found.high))
    variant, *place = _cells(run.key)
    steps, violations = (str(meta.slots), str(meta.agent_steps)), str(sum(evaluation.violations.values()))
    rows["runs"] = [[variant, name, *place, *steps, *measured, violations, meta.commit or "", meta.processor or ""]]
    results.put(run.key, rows, run.config)
    return True


def curve_rows(key: PartKey, scenario: Scenario, path: Path) -> list[list[str]]:
    """The training missions in order, averaged in groups of equal size (or one more)."""
    table = read_csv(path, ("slots", "wall_s", *_CURVE), whole_lines=True)
    if not len(table):
        raise InputError(f"{path}: no mission has ended yet")
    slots, wall_s = table.floats("slots"), table.floats("wall_s")  # (M,) each
    columns = {name: table.floats(name) for name in _CURVE}  # (M,) each
    rows = []
    for group in np.array_split(np.arange(len(table)), min(MOST_GROUPS, len(table))):
        means = {name: values[group].mean() for name, values in columns.items()}
        means["mean_aou_s"] /= scenario.slot_length_s
        last = group[-1]
        rows.append([*_cells(key), str(int(slots[last])), number(wall_s[last]), *map(number, means.values())])
    return rows


def validated_curve_rows(key: PartKey, scenario: Scenario, path: Path) -> list[list[str]]:
    """As :func:`curve_rows`, of the validation missions with sampled actions; none where ``progress.csv`` lacks them.

    They stand for the training missions of a training that ends before three of them have followed one another.
    """
    names = ("time/slots", "time/wall_s", *_VALIDATED_CURVE)
    table = read_csv(path)
    if not set(names) <= set(table.columns):
        return []
    table = table.where(cell != "" for cell in table.text(names[-1]))
    slots, wall_s, reward_s, aou_s, *counts = (table.floats(name) for name in names)  # (V,) each
    columns = zip(slots, wall_s, reward_s, aou_s / scenario.slot_length_s, *counts, strict=True)
    return [[*_cells(key), str(int(slot)), *map(number, values)] for slot, *values in columns]


def validation_rows(key: PartKey, scenario: Scenario, path: Path) -> list[list[str]]:
    """The evaluations of a training on the validation missions, from its ``progress.csv``."""
    table = read_csv(path, VALIDATION_COLUMNS)
    slots_column, time, greedy, sampled = VALIDATION_COLUMNS
    table = table.where(cell != "" for cell in table.text(greedy))
    aou = (table.floats(name) / scenario.slot_length_s for name in (greedy, sampled))
    columns = zip(table.floats(slots_column), table.floats(time), *aou, strict=True)
    return [[*_cells(key), str(int(slots)), *map(number, values)] for slots, *values in columns]


# -- an evaluation -------------------------------------------------------------------------------------


def evaluation_rows(key: PartKey, scenario: Scenario, evaluation: PolicyResult, source: str) -> Rows:
    """The rows of a final evaluation: missions, slots and devices.

    The reward of a mission is the sum over slots of r[t] = -sum_i sum_n A_i^n[t], which is -K times its mean AoU.

    Raises:
        InputError: the evaluation, from ``source``, lacks something.
    """
    tau, cells = scenario.slot_length_s, _cells(key)
    try:
        aou_s = np.asarray(evaluation.mean_aou_s, dtype=np.float64)  # (M,)
        columns = aou_s / tau, -scenario.slots * aou_s, evaluation.communications, evaluation.devices_served
        missions = [[*cells, str(mission), *map(number, row)] for mission, row in enumerate(zip(*columns, strict=True))]
        over_time = np.asarray(evaluation.aou_over_time_s, dtype=np.float64) / tau  # (K,)
        execution = [[*cells, str(slot), number(value)] for slot, value in enumerate(over_time, start=1)]
        return {"missions": missions, "execution": execution, "devices": _device_rows(cells, scenario, evaluation)}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{source}: its evaluation cannot be used ({error!r}): evaluate it again") from error


def _device_rows(cells: list[str], scenario: Scenario, evaluation: PolicyResult) -> list[list[str]]:
    """No rows where each mission draws a new layout, in which a device has no place of its own."""
    if scenario.layout == "resample":
        return []
    layout = scenario.draw_layout()
    communications = np.asarray(evaluation.device_communications, dtype=np.float64).mean(axis=0)  # (I,)
    aou = np.asarray(evaluation.device_mean_aou_s, dtype=np.float64) / scenario.slot_length_s  # (I,)
    columns = zip(*layout.positions.T, layout.update_period, communications, aou, strict=True)
    return [[*cells, str(device), *map(number, row)] for device, row in enumerate(columns)]


def _cells(key: PartKey) -> list[str]:
    return [key.variant, key.scenario, "" if key.seed is None else str(key.seed)]
