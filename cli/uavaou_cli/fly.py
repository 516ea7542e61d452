"""``uavaou fly``: rehearse a scenario, and fly one mission with the best policy found, with its map."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED, LARGEST_SEED
from uavaou.files import write_json
from uavaou_cli.evaluate import evaluation_lines
from uavaou_cli.import_ import (
    Crs,
    Endurance,
    Interval,
    MapOptions,
    Radio,
    Speed,
    Station,
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
    needed_scenario,
    number,
    option,
    seconds,
    writable_file,
    writable_folder,
)
from uavaou_cli.overrides import parse_overrides
from uavaou_cli.progress import RecordingDisplay, RehearsalDisplay
from uavaou_cli.tables import aligned, figure, interval_figures, paragraphs, show

if TYPE_CHECKING:
    from uavaou.arrays import Floats
    from uavaou.planners.base import Planner
    from uavaou.runs.rehearsal import Rehearsal
    from uavaou.scenario import Scenario

_AUTO = "auto"
_REFERENCES = ("best-first", "local-greedy-parts", "greedy")  # beside a policy that was named; they need no time


def fly(
    scenario: ScenarioName = None,
    scenario_option: ScenarioOption = None,
    policy: Annotated[
        str,
        option(
            "auto: the best in rehearsal; or a released policy, a run's folder or a planner. [default: auto]", "NAME"
        ),
    ] = _AUTO,
    seconds: Annotated[float, seconds("For the rehearsal; from 30 on it also trains a policy. [default: 10]")] = 10.0,
    knows: Knows = "everything",
    seed: Annotated[int, number("Seed of the mission.", 0, LARGEST_SEED)] = EVALUATION_SEED,
    json: Annotated[Path | None, option("Write what the rehearsal has found as JSON.", "FILE")] = None,
    out: Annotated[Path | None, option("Where the files go. [default: results/<scenario>/fly/<policy>]", "DIR")] = None,
    uavs: Uavs = None,
    station: Station = None,
    radio: Radio = None,
    crs: Crs = None,
    speed: Speed = None,
    endurance: Endurance = None,
    interval: Interval = None,
    within: Within = None,
    set_: Changes = None,
    quiet: Quiet = False,
) -> None:
    """Rehearse a scenario in simulation, and fly one mission with the policy that is best there.

    Prints how fresh each policy keeps the data, which one is served, and its mission beside that of the next best.
    Writes a page that replays both in a browser, the mission as JSON, and its pictures. `uavaou plot trajectories` also
    draws PDFs.

    SCENARIO may be a map file, such as sensors.geojson: it is imported first, as `uavaou import` does.
    """
    from uavaou.planners import planner_knowledge
    from uavaou.runs.comparison import make_policy
    from uavaou.runs.names import flight_folder, scenario_folder
    from uavaou.scenario import Scenario
    from uavaou.world.knowledge import within as knows_enough

    overrides = parse_overrides(set_ or [])
    overrides.only_of_scenario("a policy flies as it is")
    source = needed_scenario(scenario, scenario_option)
    field = None
    options = MapOptions(uavs, station, radio, crs, speed, endurance, interval, within)
    if is_map(source):
        field, base = read_map_field([Path(source)], options)
    else:
        options.refuse(source)
        base = Scenario.load(source)
    flown = overrides.of_scenario(base)
    place = Path("results") / scenario_folder(base, overrides.scenario) / "fly"
    folder = out or place / flight_folder([policy])
    writable_folder(folder)
    if field is not None:
        write_map_field(field, base, (out or place.parent) / "field")
        show([""])
    if json is not None:
        writable_file(json)
    notes: list[Path] = []
    ages: dict[str, Floats] = {}
    if policy == _AUTO:
        rehearsal = _rehearse(flown, seconds, knows, folder, quiet)
        show(_rehearsal_lines(rehearsal))
        first = rehearsal.candidates[:2]
        policies = {candidate.name: candidate.policy for candidate in first}
        if json is not None:
            write_json(json, rehearsal.to_dict())
            notes.append(json)
        ages = {one.name: one.ages_over_time for one in first}
    else:
        if json is not None:
            raise InputError(f"--json {json}: holds what a rehearsal has found, and --policy {policy} needs none")
        reference = next(
            name for name in _REFERENCES if name != policy and knows_enough(planner_knowledge(name), knows)
        )
        policies = {name: make_policy(name, flown, knows=knows) for name in (policy, reference)}
    _fly(flown, policies, seed, folder, overrides.scenario, quiet)
    if ages:
        from uavaou.reports.mission_figures import plot_rehearsal

        notes += plot_rehearsal(ages, folder, "rehearsal")
    show(notes)


def _rehearse(scenario: Scenario, seconds: float, knows: str, folder: Path, quiet: bool) -> Rehearsal:
    from uavaou.runs.rehearsal import rehearse

    places = (folder / ("training" if number == 1 else f"training-{number}") for number in count(1))
    unused = next(place for place in places if not place.exists())
    with RehearsalDisplay(quiet, seconds) as display:
        return rehearse(scenario, seconds, knows, unused, display.show)


def _rehearsal_lines(rehearsal: Rehearsal) -> list[str]:
    """The candidates, the best first; which one is served, and how sure that is."""
    from uavaou.runs.comparison import beyond_training

    scenario, best = rehearsal.scenario, rehearsal.served
    minutes = scenario.slot_length_s / 60
    rows = [
        ("policy", "knows", "missions", "mean AoU", "interval", "mean AoU"),
        ("", "", "", "(slots)", "95 %", "(min)"),
    ]
    for one in rehearsal.candidates:
        mean = one.mean
        rows.append((one.name, one.knows, str(len(one.ages)), *interval_figures(mean), figure(minutes * mean.value)))
    lines = [f"rehearsal of {scenario.name}", "", *aligned(rows, left=2)]
    texts = [
        found for one in rehearsal.candidates if one.run is None and (found := beyond_training(one.name, scenario))
    ]
    if rehearsal.late:
        texts.append(f"Too slow for the time given: {', '.join(rehearsal.late)}; --seconds gives more.")
    lead = "" if len(rehearsal.candidates) == 1 else f" Its lead is {'clear' if rehearsal.is_clear else 'not clear'}."
    run = "" if best.run is None else f" It was trained here, in {best.run.path}."
    texts.append(f"Served: {best.name}, which knows {best.knows} in flight.{lead}{run}")
    return [*lines, *paragraphs(texts), ""]


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
    from uavaou.reports.replay.page import by_label, write_replay
    from uavaou.runs.comparison import compare

    with RecordingDisplay(quiet, list(policies), scenario.slots) as display:
        comparison = compare(policies, scenario, 1, seed, display)
    show(evaluation_lines(comparison, changes))
    missions = display.missions(scenario, seed)
    name, chosen = f"mission-{seed}", missions[next(iter(policies))]
    written, page = folder / f"{name}.json", folder / f"{name}.html"
    write_mission(written, chosen)
    write_replay(page, by_label(missions.values()))
    show(["", page, written, *plot_trajectories(scenario, chosen.recording, folder, name, quick=True)])
