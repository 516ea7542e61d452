"""A rehearsal on the command line: its display, and what it has found."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from uavaou_cli.progress import NAME_WIDTH, Display
from uavaou_cli.tables import aligned, figure, interval_figures, paragraphs

if TYPE_CHECKING:
    from uavaou.runs.rehearsal import Rehearsal
    from uavaou.scenario import Scenario

AUTO = "auto"


def rehearse_in(scenario: Scenario, seconds: float, knows: str, folder: Path, quiet: bool) -> Rehearsal:
    """Rehearse with a display; a training has a folder of its own in ``folder``."""
    from uavaou.runs.rehearsal import rehearse

    places = (folder / ("training" if number == 1 else f"training-{number}") for number in count(1))
    unused = next(place for place in places if not place.exists())

    def show(share: float, at_work: str, best: float | None) -> None:
        if display.due:
            aou = "" if best is None else f"best mean AoU so far {best:,.2f} slots"
            display.advance(share * seconds, aou, at_work[:NAME_WIDTH], rate=1.0)

    with Display(quiet, seconds, "") as display:
        return rehearse(scenario, seconds, knows, unused, show)


def rehearsal_lines(rehearsal: Rehearsal) -> list[str]:
    """The candidates, the best first; which one is served, and how sure that is."""
    from uavaou.planners.plain import ignoring
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
    texts += ignoring({one.name: one.policy for one in rehearsal.candidates}, scenario)
    if rehearsal.late:
        texts.append(f"Too slow for the time given: {', '.join(rehearsal.late)}; --seconds gives more.")
    alone = len(rehearsal.candidates) == 1
    lead = "It was compared with no other." if alone else f"Its lead is {'' if rehearsal.is_clear else 'not '}clear."
    run = "" if best.run is None else f" It was trained here, in {best.run.path}."
    texts.append(f"Served: {best.name}, which knows {best.knows} in flight. {lead}{run}")
    return [*lines, *paragraphs(texts), ""]
