"""``uavaou size``: how many UAVs, from which stations, how fast and with which battery, keep the data fresh enough."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from uavaou.errors import InputError, command_line
from uavaou.files import write_text
from uavaou_cli.import_ import numbers, quantity
from uavaou_cli.options import (
    Changes,
    Knows,
    Quiet,
    ScenarioName,
    ScenarioOption,
    WhatIf,
    needed_scenario,
    option,
    seconds,
    writable_folder,
)
from uavaou_cli.overrides import parse_overrides
from uavaou_cli.progress import Display
from uavaou_cli.tables import aligned, figure, interval_figures, paragraphs, show

if TYPE_CHECKING:
    from uavaou.runs.sizing import Fleet, SizedFleet
    from uavaou.scenario import Scenario

_MOST_UAVS = 1000
_MOST_ROWS = 30
_FAST_S = 2.0  # of each fleet's rehearsal, below which planners have no time


def size(
    scenario: ScenarioName = None,
    scenario_option: ScenarioOption = None,
    uavs: Annotated[str, option("Numbers of UAVs, such as 1-6 or 1,2,4.", "NUMBERS")] = "1-6",
    target: Annotated[
        str | None, option("The mean AoU to hold, of all devices together: 'mean AoU 10 min'.", "TEXT")
    ] = None,
    station: Annotated[
        list[str] | None,
        option("Where UAVs may start: LAT,LON, or X,Y in m where a scenario has no georeference.", "PLACE"),
    ] = None,
    speed: Annotated[list[str] | None, option("To try, such as 36km/h. Repeatable.", "M/S")] = None,
    endurance: Annotated[list[str] | None, option("Time in the air to try. Repeatable.", "MIN")] = None,
    seconds: Annotated[float, seconds("For all rehearsals together.")] = 60.0,
    knows: Knows = "everything",
    out: Annotated[Path | None, option("Where the files go. [default: results/<scenario>/size]", "DIR")] = None,
    what_if: WhatIf = None,
    set_: Changes = None,
    quiet: Quiet = False,
) -> None:
    """Find the cheapest fleet that keeps the data fresh enough.

    Rehearses every fleet in question, and flies the best policy of each on 32 other missions. Writes a table, a picture
    and, with --target, the scenario of the cheapest fleet that holds it, for `uavaou fly`.

    With --what-if 'one UAV lost at half time', each UAV in turn is lost, and the worst of these losses counts.
    """
    from uavaou.runs.names import scenario_folder
    from uavaou.runs.sizing import fleets, read_target
    from uavaou.runs.what_if import what_ifs
    from uavaou.scenario import Scenario

    overrides = parse_overrides(set_ or [])
    overrides.only_of_scenario("a fleet is rehearsed as it is")
    base = Scenario.load(needed_scenario(scenario, scenario_option))
    flown = overrides.of_scenario(base)
    sizes = _sizes(uavs)
    target_s = None if target is None else read_target(target, flown.slot_length_s)
    speeds = [value for text in speed or () if (value := quantity("--speed", text, "speed_m_s", "m/s"))]
    budgets = [value for text in endurance or () if (value := quantity("--endurance", text, "endurance_s", "min"))]
    in_question, problems = fleets(flown, sizes, _stations(flown, station or ()), speeds, budgets)
    for fleet in in_question:
        what_ifs(fleet.scenario, what_if or ())
    changes = overrides.scenario | ({"what_if": "; ".join(what_if)} if what_if else {})
    folder = out or Path("results") / scenario_folder(base, changes) / "size"
    writable_folder(folder)
    found = _sized(in_question, seconds, knows, what_if or (), quiet)
    show(_lines(flown, found, target_s, seconds, what_if or ()))
    if problems:
        show(paragraphs([f"Left out, for they cannot fly: {len(problems)} more fleets, as in {problems[0]}"]))
    _write(found, target_s, folder)


def _sizes(text: str) -> list[int]:
    """The numbers of UAVs that a text such as ``1-6`` or ``1,2,4`` means."""
    sizes: set[int] = set()
    for part in text.split(","):
        ends = re.fullmatch(r"\s*(\d{1,4})(?:\s*-\s*(\d{1,4}))?\s*", part)
        low, high = (int(ends[1]), int(ends[2] or ends[1])) if ends else (0, 0)
        if not 1 <= low <= high <= _MOST_UAVS:
            raise InputError(f"--uavs {text}: expected numbers from 1 to {_MOST_UAVS}, such as 1-6 or 1,2,4")
        sizes.update(range(low, high + 1))
    return sorted(sizes)


def _stations(scenario: Scenario, texts: Sequence[str]) -> list[tuple[float, float]]:
    """The nearest grid point to each place, m."""
    import numpy as np

    places = np.array([numbers("--station", text, 2) for text in texts]).reshape(-1, 2)
    if len(places) and scenario.georeference is not None:
        from uavaou.field.geodesy import Projection

        places = Projection.of(scenario).to_metres(places)
    step, most = scenario.grid_step_m, (scenario.area_x_m, scenario.area_y_m)
    snapped = np.rint(places / step) * step
    for text, place in zip(texts, snapped, strict=True):
        if not ((place >= 0) & (place <= most)).all():
            raise InputError(f"--station {text}: outside of the area, which has {most[0]:g} x {most[1]:g} m")
    return [(float(x), float(y)) for x, y in snapped]


def _sized(
    in_question: list[Fleet], seconds: float, knows: str, what_if: Sequence[str], quiet: bool
) -> list[SizedFleet]:
    from uavaou.runs.sizing import size

    with Display(quiet, len(in_question), "") as display:

        def look(number: int, before: SizedFleet | None) -> None:
            uavs = in_question[number].scenario.uavs
            last = "" if before is None else f"last: mean AoU {before.ages_s.value / 60:,.2f} min"
            display.advance(number, last, f"{uavs} UAV{'s' if uavs > 1 else ''}")

        return size(in_question, seconds, knows, look, what_if)


def _lines(
    scenario: Scenario, found: list[SizedFleet], target_s: float | None, seconds: float, what_if: Sequence[str]
) -> list[str]:
    from uavaou.runs.sizing import best_of_each_size, cheapest, knee

    best = best_of_each_size(found)
    shown = found if len(found) <= _MOST_ROWS else list(best.values())
    rows = _rows(scenario, shown, target_s, bool(what_if))
    texts = []
    if what_if:
        texts.append(f"With {', '.join(what_if)}: the worst of these losses counts.")
    if len(shown) < len(found):
        texts.append(f"The best of each size of {len(found)} fleets; size.csv has all.")
    if (turn := knee(best)) is not None:
        texts.append(f"Knee: {turn} UAVs. More of them gain little.")
    if target_s is not None:
        chosen = cheapest(found, target_s)
        goal = f"a mean AoU of {target_s / 60:g} min"
        texts.append(
            f"No fleet here holds {goal} with its whole interval."
            if chosen is None
            else f"Cheapest that holds {goal}: {_fleet(chosen)} from {chosen.fleet.places}."
        )
    if seconds / len(found) < _FAST_S:
        texts.append(f"Each fleet had {seconds / len(found):.1f} s of rehearsal; --seconds gives more.")
    return [f"fleets for {scenario.name}", "", *aligned(rows, left=2), *paragraphs(texts)]


def _rows(scenario: Scenario, shown: list[SizedFleet], target_s: float | None, by_loss: bool) -> list[tuple[str, ...]]:
    """The table of fleets, with two lines of headings; AoI where the scenario asks for measures."""
    from uavaou.statistics import Interval

    heads = [("UAVs", ""), ("stations", "x,y (m)"), ("m/s", ""), ("in the air", "(min)"), ("mean AoU", "(min)")]
    heads += [("interval", "95 %"), ("policy", ""), ("knows", "")]
    measured = shown[0].information
    heads += [("mean AoI", "(min)"), ("largest", "AoI (min)")] if measured else []
    heads += [("time above", f"{(scenario.age_limit_s or 0) / 60:.3g} min")] if "late_share" in measured else []
    heads += ([("worst loss", "")] if by_loss else []) + ([("holds", "")] if target_s else [])
    rows = [tuple(head[k] for head in heads) for k in (0, 1)]
    for one in shown:
        fleet, minutes = one.fleet.scenario, Interval(*(age / 60 for age in one.ages_s))
        budget = "any" if fleet.flight_time == "ignore" else figure(fleet.flight_time_budget_s / 60)
        cells = [str(fleet.uavs), one.fleet.places, f"{fleet.speed_m_s:g}", budget, *interval_figures(minutes)]
        cells += [one.policy, one.knows]
        cells += [figure(one.information[name] / 60) for name in ("mean_aoi_s", "peak_aoi_s") if measured]
        cells += [f"{one.information['late_share']:.1%}"] if "late_share" in measured else []
        cells += ([one.worst_loss] if by_loss else []) + ([one.verdict(target_s)] if target_s else [])
        rows.append(tuple(cells))
    return rows


def _fleet(one: SizedFleet) -> str:
    uavs = one.fleet.scenario.uavs
    return f"{uavs} UAV{'s' if uavs > 1 else ''}"


def _write(found: list[SizedFleet], target_s: float | None, folder: Path) -> None:
    import pandas as pd

    from uavaou.csv_tables import write_table
    from uavaou.plain_yaml import to_yaml
    from uavaou.reports.fleet_figure import plot_fleets
    from uavaou.runs.sizing import cheapest

    table = folder / "size.csv"
    write_table(table, pd.DataFrame([one.row(target_s) for one in found]))
    show(["", table, *plot_fleets(found, target_s, folder)])
    chosen = None if target_s is None else cheapest(found, target_s)
    if chosen is not None:
        path = folder / "scenario.yaml"
        write_text(
            path, f"# The cheapest fleet that holds the target: size.csv.\n{to_yaml(chosen.fleet.scenario.to_dict())}"
        )
        show([path, "", f"Next: {command_line(['uavaou', 'fly', path])}"])
