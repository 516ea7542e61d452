"""``uavaou eval --suite``: trained runs and planners at every point of an evaluation suite."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uavaou.errors import InputError
from uavaou_cli.checks import writable_file
from uavaou_cli.overrides import Overrides
from uavaou_cli.tables import show

if TYPE_CHECKING:
    from uavaou.planners.base import Planner
    from uavaou.runs.folder import RunConfig, RunFolder
    from uavaou.scenario import Scenario
    from uavaou.suites.assignment import Assignment, Entry, Missing
    from uavaou.suites.results import Job, Result
    from uavaou.suites.suite import Place, Suite


@dataclass(frozen=True)
class Request:
    """What the command line asked for."""

    suite: str
    scenario: str | None
    overrides: Overrides
    episodes: int
    seed: int
    action: str | None
    out: Path | None
    json: Path | None
    quiet: bool


@dataclass(frozen=True)
class Plan:
    """Who plays what."""

    suite: Suite
    name: str  # of the suite, with what was changed in its scenario
    base: Scenario
    places: list[Place]
    entries: list[Entry]
    assignments: list[Assignment]
    missing: list[Missing]
    jobs: list[Job]


def evaluate_suite(request: Request, configs: Mapping[str, RunConfig], planners: Mapping[str, Planner]) -> None:
    """Play a suite, print its table, and write the files; without policies, say what it needs."""
    from uavaou_cli.suite_tables import suite_lines, suite_points

    plan = _plan(request, configs, list(planners))
    for path in (request.out, request.json):
        if path is not None:
            writable_file(path)
    if request.out is not None and request.json is not None and request.out.resolve() == request.json.resolve():
        raise InputError(f"--out and --json are both '{request.out}': give each a file of its own")
    if not configs and not planners:
        show(suite_points(plan.suite, plan.base, plan.places, plan.missing))
        return
    _check_runs(plan, request.action)
    results: list[Result] = []
    notes: list[str] = []
    try:
        _play(plan, planners, request, results)
        notes = _write(plan, results, request)
    finally:  # what has been played is shown even where Ctrl-C ended it, or a disk has filled
        show(suite_lines(plan, results, request.episodes, request.seed))
    for note in notes if not request.quiet else []:
        print(note, file=sys.stderr)


def _plan(request: Request, configs: Mapping[str, RunConfig], planners: list[str]) -> Plan:
    from uavaou.scenario import Scenario
    from uavaou.suites.assignment import assign, missing_runs, name_entries, needs
    from uavaou.suites.results import suite_jobs
    from uavaou.suites.suite import Suite, suite_name, suite_places

    suite = Suite.load(request.suite)
    source = request.scenario or suite.scenario
    base = request.overrides.of_scenario(Scenario.load(source))
    _refuse_changed(suite, request.overrides)
    changed = {} if request.scenario is None else {"scenario": Scenario.load(source).name}
    name = suite_name(suite, changed | request.overrides.scenario)
    places = suite_places(suite, base)
    entries = name_entries({Path(run): config for run, config in configs.items()}, suite)
    assignments = assign(places, entries, base)
    wanted = assignments if configs or planners else needs(places, "mappo")
    missing = missing_runs(wanted, entries, source, base)
    return Plan(suite, name, base, places, entries, assignments, missing, suite_jobs(places, assignments, planners))


def _refuse_changed(suite: Suite, overrides: Overrides) -> None:
    """Refuse to set what the points of the suite set: theirs would stand, under a name that says otherwise."""
    varied = {field for point in suite.points for field in point.set}
    for key in overrides.scenario:
        if key.split(".")[0] in varied:
            raise InputError(f"--set scenario.{key}: is what the points of the suite '{suite.name}' set themselves")


def _check_runs(plan: Plan, action: str | None) -> None:
    """Load every run that will play once: a damaged one is found before hours are spent."""
    if any(job.entry is not None for job in plan.jobs):
        load = _loader(action)
        for entry in {id(job.entry): job.entry for job in plan.jobs}.values():
            if entry is not None:
                load(entry.folder, entry.config.scenario)


def _loader(action: str | None) -> Any:
    def load(folder: RunFolder, scenario: Scenario) -> Planner:
        from uavaou.runs.policy import load_run  # imports torch, which planners do without

        return load_run(folder, scenario, action)

    return load


def _play(plan: Plan, planners: Mapping[str, Planner], request: Request, results: list[Result]) -> None:
    from uavaou.suites.results import play_suite
    from uavaou_cli.progress import EvaluationDisplay

    slots = max((job.place.scenario.slots for job in plan.jobs if job.place.scenario is not None), default=0)
    names = [job.name for job in plan.jobs]
    with EvaluationDisplay(request.quiet, names, request.episodes * slots) as progress:
        load = _loader(request.action)
        for result in play_suite(
            plan.jobs, planners, load, request.episodes, request.seed, progress.start, progress.after_slot
        ):
            results.append(result)


def _write(plan: Plan, results: list[Result], request: Request) -> list[str]:
    """Write the files; returns a note on each."""
    from uavaou.runs.results import keep_evaluation, write_evaluation
    from uavaou.suites.results import csv_rows, suite_json, write_csv

    episodes, seed, notes = request.episodes, request.seed, []
    for entry in plan.entries:
        content = suite_json(plan.suite, plan.base, results, episodes, seed, entry)
        if content.points:
            notes.append(keep_evaluation(entry.folder.evaluation(plan.name), content))
    if request.json is not None:
        content = suite_json(plan.suite, plan.base, results, episodes, seed)
        notes.append(_written(request.json, lambda path: write_evaluation(path, content)))
    if request.out is not None:
        rows = csv_rows(plan.name, plan.suite, results)
        notes.append(_written(request.out, lambda path: write_csv(path, rows)))
    return notes


def _written(path: Path, write: Callable[[Path], None]) -> str:
    try:
        write(path)
    except OSError as error:
        raise InputError(f"cannot write '{path}': {error.strerror or error}") from error
    return f"wrote {path}"
