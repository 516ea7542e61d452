"""Run folders as the tables of a study, in memory, so that one set of figures serves runs and studies."""

from collections.abc import Iterable
from pathlib import Path

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.csv_tables import read_csv
from uavaou.errors import InputError
from uavaou.reports import style
from uavaou.runs.folder import RunFolder
from uavaou.runs.results import PolicyResult, read_evaluations
from uavaou.scenario import Scenario
from uavaou.studies.condense import VALIDATION_COLUMNS, curve_rows, evaluation_rows, validation_rows
from uavaou.studies.folder import PartKey, StudyFolder
from uavaou.studies.results import StudyResults

_LEARNED_NAMES = ("policy", "model", "learned")  # what an evaluation may call the run's own policy


def read_runs(folders: Iterable[Path]) -> tuple[StudyResults, dict[PartKey, PolicyResult]]:
    """Condense training runs as a study does; runs of one name on one scenario become its seeds.

    Planners come from the evaluations: they play the same missions beside every run, so that one result is taken.

    Args:
        folders: of the runs, ``.../<scenario>/<algorithm>/seed-<n>``; finished, evaluated, or neither.

    Returns:
        The tables, and the evaluations, which also hold values of each mission.

    Raises:
        InputError: there is no run, or a file of one is missing or malformed.
    """
    results = StudyResults(StudyFolder(Path("runs")), {"scenarios": {}, "variants": {}}, {})
    evaluations: dict[PartKey, PolicyResult] = {}
    for path in folders:
        _add_run(results, evaluations, RunFolder(Path(path)))
    if not results.parts:
        raise InputError("no run folders to draw figures from")
    return results, evaluations


def _add_run(results: StudyResults, evaluations: dict[PartKey, PolicyResult], folder: RunFolder) -> None:
    config = folder.read_config()
    scenario = config.scenario
    place, variant = _name(scenario, folder.path.parent.parent), _name(config.algorithm, folder.path.parent)
    results.settings["scenarios"].setdefault(place, scenario.to_dict())
    results.settings["variants"].setdefault(variant, {"name": variant})
    seeds = sum(key[:2] == (variant, place) for key in results.parts)
    key = PartKey(variant, place, seeds)  # a number for each run: runs from two folders may have the same seed
    rows = {"curves": curve_rows(key, scenario, folder.episodes)}
    progress = folder.path / "progress.csv"
    if progress.is_file() and set(VALIDATION_COLUMNS) <= set(read_csv(progress).columns):
        rows["validation"] = validation_rows(key, scenario, progress)
    own = {style.base_name(variant), *_LEARNED_NAMES}
    for policy, result in _evaluation(folder).items():
        if policy in own:
            rows |= evaluation_rows(key, scenario, result, str(folder.path))
            evaluations[key] = result
        elif (planner := PartKey(policy, place)) not in results.parts:
            results.put(planner, evaluation_rows(planner, scenario, result, str(folder.path)))
            evaluations[planner] = result
    results.put(key, rows)


def _name(stated: Scenario | AlgorithmConfig, folder: Path) -> str:
    """The name in the configuration; the folder's where that adds overrides to it."""
    return folder.name if folder.name.split("+", 1)[0] == stated.name else stated.name


def _evaluation(folder: RunFolder) -> dict[str, PolicyResult]:
    """Policy -> result in the run's own evaluation, or in a suite whose one point is the run's scenario."""
    found = read_evaluations(folder)
    return found.get("default") or next(iter(found.values()), {})
