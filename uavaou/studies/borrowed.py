"""What other studies below the same folder know: runs with the same settings, which are taken over, and durations."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from statistics import fmean
from typing import Any

from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.runs.folder import RunConfig
from uavaou.studies.folder import PLANNED, PartKey, StudyFolder
from uavaou.studies.results import COLUMNS, Rows, StudyResults, read_begun
from uavaou.studies.study import Study


def borrow(results: StudyResults, study: Study, out: Path) -> None:
    """Add the rows of trainings and planners that other studies have with the same settings and missions.

    Args:
        results: get the rows of parts that they lack.
        study: theirs.
        out: the folder of all results.
    """
    wanted = {run.config: run.key for run in study.runs() if run.key not in results.parts}
    planners = [key for key in study.planner_parts() if key not in results.parts]
    for other in _others(study, out) if wanted or planners else ():
        if (other.settings.get("episodes"), other.settings.get("evaluation_seed")) != (study.episodes, EVALUATION_SEED):
            continue
        for key, config in _configs(other):
            if (own := wanted.pop(config, None)) is not None:
                results.put(own, _renamed(other.parts[key], own), config)
        places = {name: scenario.to_dict() for name, scenario in study.scenarios.items()}
        held = other.settings.get("scenarios") or {}
        for own in planners:
            same = [name for name, fields in held.items() if fields == places[own.scenario]]
            found = [PartKey(own.variant, name) for name in same if PartKey(own.variant, name) in other.parts]
            planned = own.variant not in PLANNED or other.settings.get("planning_seconds") == study.planning_seconds
            if found and planned and own not in results.parts:
                results.put(own, _renamed(other.parts[found[0]], own))


def expected_cpu_s(study: Study, results: StudyResults, out: Path) -> tuple[float, list[str]]:
    """How many CPU seconds the trainings take that are left, and the algorithms with networks not yet measured.

    A training takes as long for each slot as those of its algorithm, network and hidden layers did, or where there are
    none, as those of its algorithm with its network.

    Args:
        study: what is to be run.
        results: so far.
        out: the folder of all results, with the tables of this and other studies.
    """
    rates: dict[tuple[Any, ...], list[float]] = {}  # CPU seconds a slot
    for other in [results, *_others(study, out)]:
        for key, config in _configs(other):
            cpu_s, slots = other.cell(key, "cpu_s"), float(other.cell(key, "slots"))
            for kind in _kinds(config) if cpu_s else ():
                rates.setdefault(kind, []).append(float(cpu_s) / slots)
    if not rates:
        return 0.0, []
    left = [run.config for run in study.runs() if run.key not in results.parts]
    total, unknown = 0.0, []
    for config in left:
        known = [rates[kind] for kind in _kinds(config) if kind in rates]
        if known:
            total += fmean(known[0]) * config.slots
        if len(known) < len(_kinds(config)):
            network = getattr(config.algorithm, "network", "a network of its own")
            unknown.append(
                " ".join([config.algorithm.name, network, *map(str, getattr(config.algorithm, "hidden", ()))])
            )
    return total, list(dict.fromkeys(unknown))


def _kinds(config: RunConfig) -> list[tuple[Any, ...]]:
    """What a duration depends on, the most exact first."""
    algorithm = config.algorithm
    kind = (algorithm.name, getattr(algorithm, "network", None))
    return [(*kind, getattr(algorithm, "hidden", None)), kind]


def _others(study: Study, out: Path) -> Iterator[StudyResults]:
    """The results of the other studies below ``out``; damaged ones are their own problem."""
    for path in sorted((out / "studies").glob("*/study.yaml")):
        if path.parent.name != study.name:
            with suppress(InputError):
                yield read_begun(StudyFolder(path.parent))


def _configs(results: StudyResults) -> Iterator[tuple[PartKey, RunConfig]]:
    for key in results.parts:
        if key.seed is not None and results.folder.config(key).is_file():
            with suppress(InputError):
                yield key, results.folder.read_config(key)


def _renamed(rows: Rows, key: PartKey) -> Rows:
    """The rows of a part under another name."""
    cells = {"variant": key.variant, "scenario": key.scenario}
    return {
        name: [
            [cells.get(column, cell) for column, cell in zip(COLUMNS[name], row, strict=True)] for row in lines
        ]
        for name, lines in rows.items()
    }  # fmt: skip
