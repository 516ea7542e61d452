"""``uavaou eval --suite``: trained runs and planners at every point of an evaluation suite."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from uavaou.errors import InputError
from uavaou_cli.checks import writable_file
from uavaou_cli.overrides import Overrides
from uavaou_cli.tables import show

if TYPE_CHECKING:
    from uavaou.planners.base import Planner
    from uavaou.runs.folder import RunConfig
    from uavaou.suites.play import PointResult


@dataclass(frozen=True)
class Request:
    """The options of the command."""

    suite: str
    scenario: str | None
    overrides: Overrides
    episodes: int
    seed: int
    action: str | None
    out: Path | None
    json: Path | None
    quiet: bool


def evaluate_suite(request: Request, configs: Mapping[str, RunConfig], planners: Mapping[str, Planner]) -> None:
    """Play a suite, print its table, and write the files; without policies, say what it needs."""
    from uavaou.scenario import Scenario
    from uavaou.suites.play import plan_suite, play_suite
    from uavaou.suites.suite import Suite
    from uavaou.suites.table import write_suite
    from uavaou_cli.progress import EvaluationDisplay
    from uavaou_cli.suite_tables import suite_lines, suite_points

    suite, overrides = Suite.load(request.suite), request.overrides
    base = overrides.of_scenario(Scenario.load(request.scenario or suite.scenario))
    plan = plan_suite(suite, configs, list(planners), request.scenario, base, overrides.scenario)
    for path in (request.out, request.json):
        if path is not None:
            writable_file(path)
    if request.out is not None and request.json is not None and request.out.resolve() == request.json.resolve():
        raise InputError(f"--out and --json are both '{request.out}': give each a file of its own")
    if not configs and not planners:
        show(suite_points(plan))
        return
    plan.check_runs(request.action)
    slots = request.episodes * max((flight.scenario.slots for flight in plan.flights), default=0)
    results: list[PointResult] = []
    notes: list[str] = []
    try:
        with EvaluationDisplay(request.quiet, [flight.name for flight in plan.flights], slots) as display:
            for result in play_suite(plan, planners, request.episodes, request.seed, display, request.action):
                results.append(result)
        notes = write_suite(plan, results, request.episodes, request.seed, request.out, request.json)
    finally:  # what has been played is shown even where Ctrl-C ended it, or a disk has filled
        show(suite_lines(plan, results, request.episodes, request.seed))
    for note in notes if not request.quiet else []:
        print(note, file=sys.stderr)
