"""``uavaou fly``: rehearse a scenario, and fly one mission with the best policy found, with its map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED, LARGEST_SEED
from uavaou.files import write_json
from uavaou_cli.evaluate import evaluation_lines
from uavaou_cli.import_ import (
    Crs,
    Duration,
    Endurance,
    Interval,
    MapOptions,
    Radio,
    Speed,
    Station,
    Swap,
    Uavs,
    Within,
    is_map,
    read_map_field,
    write_map_field,
)
from uavaou_cli.options import (
    Changes,
    Knows,
    Quiet,
    ScenarioName,
    ScenarioOption,
    WhatIf,
    needed_scenario,
    number,
    option,
    seconds,
    writable_file,
    writable_folder,
)
from uavaou_cli.overrides import parse_overrides
from uavaou_cli.progress import RecordingDisplay
from uavaou_cli.rehearsal import AUTO, rehearsal_lines, rehearse_in
from uavaou_cli.route import ROUTE_FOLDER, check_routes, write_routes
from uavaou_cli.tables import bullet, show

if TYPE_CHECKING:
    from uavaou.arrays import Floats
    from uavaou.planners.base import Planner
    from uavaou.scenario import Scenario

_REFERENCES = ("best-first", "local-greedy-parts", "greedy")  # beside a policy that was named; they need no time


def fly(
    scenario: ScenarioName = None,
    scenario_option: ScenarioOption = None,
    policy: Annotated[
        str,
        option("auto: the best in rehearsal; or a released policy, a run's folder or a planner.", "NAME"),
    ] = AUTO,
    seconds: Annotated[float, seconds("For the rehearsal; from 30 on it also trains a policy.")] = 10.0,
    knows: Knows = "everything",
    seed: Annotated[int, number("Seed of the mission.", 0, LARGEST_SEED)] = EVALUATION_SEED,
    json: Annotated[Path | None, option("Write what the rehearsal has found as JSON.", "FILE")] = None,
    out: Annotated[Path | None, option("Where the files go. [default: results/<scenario>/fly/<policy>]", "DIR")] = None,
    route: Annotated[
        list[str] | None, option("Also write its routes: plan, wpl, kml, geojson or csv. Repeatable.", "FORMAT")
    ] = None,
    uavs: Uavs = None,
    station: Station = None,
    radio: Radio = None,
    crs: Crs = None,
    speed: Speed = None,
    endurance: Endurance = None,
    interval: Interval = None,
    within: Within = None,
    duration: Duration = None,
    swap: Swap = None,
    what_if: WhatIf = None,
    set_: Changes = None,
    quiet: Quiet = False,
) -> None:
    """Rehearse a scenario in simulation, and fly one mission with the policy that is best there.

    Prints how fresh each policy keeps the data, which one is served, and its mission beside that of the next best.
    Writes a page that replays both in a browser, the mission as JSON, and its pictures. --route adds what
    `uavaou route` writes.

    --what-if loses a UAV on the way, in the rehearsal as in the mission.

    SCENARIO may be a map file, such as sensors.geojson: it is imported first, as `uavaou import` does.
    """
    from uavaou.planners import planner_knowledge
    from uavaou.runs.comparison import make_policy
    from uavaou.runs.names import flight_folder, scenario_folder
    from uavaou.runs.what_if import what_if as happening
    from uavaou.scenario import Scenario
    from uavaou.world.knowledge import within as knows_enough

    overrides = parse_overrides(set_ or [])
    overrides.only_of_scenario("a policy flies as it is")
    source = needed_scenario(scenario, scenario_option)
    field = None
    options = MapOptions(uavs, station, radio, crs, speed, endurance, interval, within, duration, swap)
    if is_map(source):
        field, base = read_map_field([Path(source)], options)
    else:
        options.refuse(source)
        base = Scenario.load(source)
    flown = happening(overrides.of_scenario(base), what_if or ())
    changes = overrides.scenario | ({"what_if": "; ".join(what_if)} if what_if else {})
    place = Path("results") / scenario_folder(base, changes) / "fly"
    folder = out or place / flight_folder([policy])
    writable_folder(folder)
    if route:
        check_routes(flown, route)
    if field is not None:
        write_map_field(field, base, (out or place.parent) / "field")
        show([""])
    if json is not None:
        writable_file(json)
    notes: list[Path] = []
    ages: dict[str, Floats] = {}
    planned: dict[str, Planner] = {}
    if policy == AUTO:
        rehearsal = rehearse_in(flown, seconds, knows, folder, quiet)
        show(rehearsal_lines(rehearsal))
        first = rehearsal.candidates[:2]
        policies = {candidate.name: candidate.policy for candidate in first}
        if json is not None:
            write_json(json, rehearsal.to_dict())
            notes.append(json)
        ages = {one.name: one.ages_over_time for one in first}
        planned = rehearsal.open_loop
    else:
        if json is not None:
            raise InputError(f"--json {json}: holds what a rehearsal has found, and --policy {policy} needs none")
        reference = next(
            name for name in _REFERENCES if name != policy and knows_enough(planner_knowledge(name), knows)
        )
        policies = {name: make_policy(name, flown, knows=knows) for name in (policy, reference)}
    _fly(flown, policies, seed, folder, changes, quiet)
    if ages:
        from uavaou.reports.mission_figures import plot_rehearsal

        notes += plot_rehearsal(ages, folder, "rehearsal")
    show(notes)
    if route:
        show([""])
        name, flying = next(iter(policies.items()))
        write_routes(flown, name, flying, planned, route, folder / ROUTE_FOLDER, quiet=quiet)


def _fly(
    scenario: Scenario,
    policies: dict[str, Planner],
    seed: int,
    folder: Path,
    changes: dict[str, str],
    quiet: bool,
) -> None:
    """Fly a mission with each policy; print the figures, and write the files of the first."""
    from uavaou.evaluation.recorded_mission import write_mission
    from uavaou.reports.mission_figures import plot_trajectories
    from uavaou.reports.mission_story import mission_story
    from uavaou.reports.replay.page import by_label, write_replay
    from uavaou.runs.comparison import compare

    with RecordingDisplay(quiet, list(policies), scenario.slots) as display:
        comparison = compare(policies, scenario, 1, seed, display)
    show(evaluation_lines(comparison, changes))
    missions = display.missions(scenario, seed)
    first = next(iter(policies))
    name, chosen = f"mission-{seed}", missions[first]
    if story := mission_story(first, chosen):
        show(["", story[0], *(line for text in story[1:] for line in bullet(text))])
    written, page = folder / f"{name}.json", folder / f"{name}.html"
    write_mission(written, chosen)
    write_replay(page, by_label(missions.values()))
    show(["", page, written, *plot_trajectories(scenario, chosen.recording, folder, name, quick=True)])
