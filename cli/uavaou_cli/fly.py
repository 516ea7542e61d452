"""``uavaou fly``: one mission at once, beside a reference, with its map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from uavaou.evaluation.seeds import EVALUATION_SEED, LARGEST_SEED
from uavaou_cli.evaluate import evaluation_lines
from uavaou_cli.options import (
    Changes,
    Quiet,
    ScenarioName,
    ScenarioOption,
    needed_scenario,
    number,
    option,
    writable_folder,
)
from uavaou_cli.overrides import parse_overrides
from uavaou_cli.progress import RecordingDisplay
from uavaou_cli.tables import say, show

_DEFAULT = "any-map"
_REFERENCES = ("best-first", "greedy")  # planners that need no time; also the default without a released policy


def fly(
    scenario: ScenarioName = None,
    scenario_option: ScenarioOption = None,
    policy: Annotated[
        str | None, option("A released policy, a run's folder or a planner. [default: any-map]", "NAME")
    ] = None,
    seed: Annotated[int, number("Seed of the mission.", 0, LARGEST_SEED)] = EVALUATION_SEED,
    out: Annotated[Path | None, option("Where the files go. [default: results/<scenario>/fly/<policy>]", "DIR")] = None,
    set_: Changes = None,
    quiet: Quiet = False,
) -> None:
    """Fly one mission of a scenario, print its figures beside a reference, and draw its map.

    Writes a page that replays the mission beside the reference's in a browser, the mission as JSON, and its pictures
    as PNG and PDF.
    """
    from uavaou.runs.comparison import compare, make_policy
    from uavaou.runs.folder import flight_folder, scenario_folder
    from uavaou.scenario import Scenario

    overrides = parse_overrides(set_ or [])
    overrides.only_of_scenario("a policy flies as it is")
    base = Scenario.load(needed_scenario(scenario, scenario_option))
    flown = overrides.of_scenario(base)
    chosen = _default() if policy is None else policy
    reference = next(name for name in _REFERENCES if name != chosen)
    place = Path("results") / scenario_folder(base, overrides.scenario) / "fly"
    folder = out or place / flight_folder([chosen])
    writable_folder(folder)
    policies = {name: make_policy(name, flown) for name in (chosen, reference)}
    with RecordingDisplay(quiet, list(policies), flown.slots) as display:
        comparison = compare(policies, flown, 1, seed, display)
    show(evaluation_lines(comparison, overrides.scenario))
    if policy is None and chosen != _DEFAULT:
        say([f"flown by {chosen}: no policy '{_DEFAULT}' comes with this version"], quiet)
    from uavaou.evaluation.recorded_mission import write_mission
    from uavaou.reports.mission_figures import plot_trajectories
    from uavaou.reports.replay.page import by_label, write_replay

    missions = display.missions(flown, seed)
    name = f"mission-{seed}"
    written, page = folder / f"{name}.json", folder / f"{name}.html"
    write_mission(written, missions[chosen])
    write_replay(page, by_label(missions.values()))
    show(["", page, written, *plot_trajectories(flown, missions[chosen].recording, folder, name)])


def _default() -> str:
    """The released policy for every map, or without it the best planner that needs no time to plan."""
    from uavaou.runs.released import released_names

    return _DEFAULT if _DEFAULT in released_names() else _REFERENCES[0]
