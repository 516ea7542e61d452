"""``uavaou replay``: one mission as several policies fly it, to watch in a browser or as a film."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED, LARGEST_SEED
from uavaou_cli.evaluate import evaluation_lines
from uavaou_cli.options import (
    Changes,
    Knows,
    Quiet,
    choice,
    number,
    option,
    refuse_scenarios,
    seconds,
    trained,
    writable_file,
)
from uavaou_cli.overrides import Overrides, parse_overrides
from uavaou_cli.progress import Display, RecordingDisplay
from uavaou_cli.tables import show

if TYPE_CHECKING:
    from uavaou.evaluation.recorded_mission import RecordedMission
    from uavaou.scenario import Scenario

_FORMATS = ("html", "gif", "mp4")


def replay(
    policy: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN|POLICY",
            help="Runs, released policies, planners, plans, or missions as `uavaou fly` records them.",
            autocompletion=trained,
        ),
    ],
    scenario: Annotated[str | None, option("A preset or a YAML file. [default: of plan or RUN, else paper]")] = None,
    seed: Annotated[int | None, number("Seed of the mission. [default: 10000]", 0, LARGEST_SEED)] = None,
    format: Annotated[
        str | None, choice("A page for a browser, or a film. [default: as --out ends, else html]", *_FORMATS)
    ] = None,
    out: Annotated[
        Path | None, option("The file to write. [default: results/<scenario>/replay/<policies>/mission-<seed>]", "FILE")
    ] = None,
    slots: Annotated[int | None, number("A film ends with slot N. [default: with the mission]", 1)] = None,
    time_limit: Annotated[float | None, seconds("Time limit of planners that plan ahead, in seconds.")] = None,
    knows: Knows = "everything",
    set_: Changes = None,
    quiet: Quiet = False,
) -> None:
    """Replay one mission as each policy flies it, side by side and in step.

    The page is one file that needs no server and no network. It shows the map, the AoU and every device, slot by slot.
    mp4 needs `pip install 'uavaou[video]'`.
    """
    from uavaou.evaluation.recorded_mission import read_mission
    from uavaou.runs.names import flight_folder, scenario_folder

    names = list(dict.fromkeys(policy))
    refuse_scenarios(names)
    form = _format(format, out)
    if form == "html" and slots is not None:
        raise InputError(f"--slots {slots}: is for films (--format gif or mp4); a page holds the whole mission")
    overrides = parse_overrides(set_ or [])
    overrides.only_of_scenario("a policy flies as it is")
    recorded = {name: read_mission(Path(name)) for name in names if _is_recorded(name)}
    flying = [name for name in names if name not in recorded]
    base = _base_scenario(flying, scenario, recorded)
    flown = overrides.of_scenario(base)
    first = next(iter(recorded.values()), None)
    mission_seed = seed if seed is not None else EVALUATION_SEED if first is None else first.mission_seed
    default = Path("results") / scenario_folder(base, overrides.scenario) / "replay" / flight_folder(names)
    path = out or default / f"mission-{mission_seed}.{form}"
    writable_file(path)
    if form != "html":
        from uavaou.reports.replay.film import check_format

        check_format(form)
    missions = recorded | _fly(flying, flown, overrides, mission_seed, time_limit, knows, quiet)
    _write(path, form, [missions[name] for name in names], slots, quiet)
    print(path)


def _format(format: str | None, out: Path | None) -> str:
    """The format that the options name, by word or by the end of the file's name."""
    ending = "" if out is None else out.suffix[1:].lower()
    if out is None or (format is None and ending in _FORMATS):
        return format or ending or "html"
    if format is None or ending != format:
        expected = f"a file of --format {format} ends in .{format}" if format else "expected .html, .gif or .mp4"
        raise InputError(f"--out {out}: {expected}")
    return format


def _is_recorded(name: str) -> bool:
    """Whether the name is that of a recorded mission's file; one that holds a planner is a plan."""
    from uavaou.files import read_json

    if not name.endswith(".json") or not Path(name).is_file():
        return False
    content = read_json(Path(name))
    return not isinstance(content, dict) or "planner" not in content


def _base_scenario(names: Sequence[str], scenario: str | None, recorded: dict[str, RecordedMission]) -> Scenario:
    """The scenario that is flown, before changes: as given, of the recorded missions, of the runs, or the paper's."""
    from uavaou.runs.comparison import common_scenario, is_planner, planned_scenario, read_runs
    from uavaou.scenario import Scenario

    configs = read_runs([name for name in names if not is_planner(name)])
    if scenario is not None:
        return Scenario.load(scenario)
    if recorded:
        return next(iter(recorded.values())).scenario
    return planned_scenario(names) or (common_scenario(configs) if configs else Scenario.load("paper"))


def _fly(
    names: Sequence[str],
    scenario: Scenario,
    overrides: Overrides,
    seed: int,
    limit_s: float | None,
    knows: str,
    quiet: bool,
) -> dict[str, RecordedMission]:
    """Fly the mission with each policy, and print the figures."""
    from uavaou.planners import PLAN_AHEAD
    from uavaou.runs.comparison import compare, make_policy

    if limit_s is not None and not any(name in PLAN_AHEAD for name in names):
        raise InputError(f"--time-limit {limit_s:g}: needs a planner that plans ahead: {', '.join(PLAN_AHEAD)}")
    if not names:
        return {}
    policies = {name: make_policy(name, scenario, limit_s, knows) for name in names}
    with RecordingDisplay(quiet, list(policies), scenario.slots) as display:
        comparison = compare(policies, scenario, 1, seed, display)
    show([*evaluation_lines(comparison, overrides.scenario), ""])
    return display.missions(scenario, seed)


def _write(path: Path, format: str, missions: Sequence[RecordedMission], slots: int | None, quiet: bool) -> None:
    from uavaou.reports.replay.page import by_label, write_replay

    labelled = by_label(missions)
    if format == "html":
        write_replay(path, labelled)
        return
    from uavaou.reports.replay.film import film_slots, write_film

    with Display(quiet, film_slots(labelled, slots)) as display:
        for slot in write_film(path, labelled, format, slots):
            if display.due:
                display.advance(slot, f"slot {slot:,}", format)
