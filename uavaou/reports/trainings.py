"""Each training of a study by itself: its level, when it converged, its structure; strays of variants, tested."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uavaou.csv_tables import write_csv
from uavaou.reports.markdown import rounded, table
from uavaou.reports.training_claims import SMOOTHED, WITHIN, converged, smooth
from uavaou.statistics.counts import fisher
from uavaou.studies.folder import PartKey
from uavaou.studies.results import StudyResults
from uavaou.studies.structure import HELD, Structure, strays, structures

COLUMNS = ("variant", "scenario", "seed", "mean_aou_slots", "level_slots", "converged_slots", "structure", "strays")
_HEAD = ("policy", "seed", "mean AoU (slots)", "level (slots)", "converged at", "structure")
_NOTE = f"""\
Level: the lowest validation AoU of the training, averaged over {SMOOTHED} evaluations. Converged at: the training slots
from which on that average stays within {WITHIN:.0%} of the level. Structure: the devices that the team holds, those of
the shortest update period that are collected in at least {HELD:.0%} of the slots in which they have a new update. Some
UAV is then within range of each of them in nearly every such slot; it need not be the same one, nor wait there."""


def write_trainings(path: Path, results: StudyResults) -> None:
    """Write a row for each training."""
    found = structures(results)
    write_csv(path, COLUMNS, (_row(results, key, found.get(key)) for key in _keys(results)))


def _keys(results: StudyResults) -> list[PartKey]:
    keys = [key for key in results.parts if key.seed is not None and "validation" in results.parts[key]]
    order = [*results.algorithms]
    return sorted(keys, key=lambda key: (list(results.scenarios).index(key.scenario), order.index(key.variant)))


def _row(results: StudyResults, key: PartKey, structure: Structure | None) -> list[str]:
    run = results.table("validation", *key)
    moment = converged(run["mean_aou_slots"])
    at = str(int(run["slots"][moment.place])) if moment.happened else ""
    level = f"{smooth(run['mean_aou_slots']).min():.6g}"
    held, strayed = ("", "") if structure is None else (" ".join(map(str, structure.held)), str(int(structure.strays)))
    mean = results.cell(key, "mean_aou_slots")
    return [key.variant, key.scenario, str(key.seed), mean, level, at, held, strayed]


def trainings_section(results: StudyResults) -> list[str]:
    """The page's part on each training, and on the variants' strays; nothing where no training has validations."""
    found, keys = structures(results), _keys(results)
    parts = [f"## Trainings\n\n{_NOTE}"] if keys else []
    for scenario in dict.fromkeys(key.scenario for key in keys):
        if len(results.scenarios) > 1:
            parts.append(f"### {scenario}")
        rows = [_cells(_row(results, key, found.get(key))) for key in keys if key.scenario == scenario]
        parts.append(table(_HEAD, rows))
    return [*parts, *_strays(results, found)]


def _cells(row: list[str]) -> tuple[str, ...]:
    variant, _, seed, mean, level, at, held, strayed = row
    structure = "" if not strayed else (held.replace(" ", ", ") or "none") + (" (strays)" if strayed == "1" else "")
    told = f"{int(at):,} slots" if at else "never"
    return f"`{variant}`", seed, rounded(float(mean), 4), rounded(float(level), 4), told, structure


def _strays(results: StudyResults, found: Mapping[PartKey, Structure]) -> list[str]:
    """How many trainings of each variant stray; where the study states what that is, also the test of Fisher.

    Without such a statement the trainings themselves say what is common, and a test on that would be circular. With
    ``behind`` the best of all of them is the measure: of variants of one algorithm, none is favoured by that.
    """
    variants = list(results.algorithms)
    own = results.reference or next(iter(variants), "")
    behind = results.settings.get("behind")
    tested = bool(results.settings.get("held") or behind)
    incomparable = {name for name in variants if behind and results.algorithms[name] != results.algorithms[own]}
    parts = []
    for scenario in results.scenarios:
        counts = {name: strays(found, name, scenario) for name in variants}
        if max((of for _, of in counts.values()), default=0) < 2 or own not in counts:
            continue
        rows = []
        for name, (strayed, of) in counts.items():
            p = "" if name == own or not of or name in incomparable else rounded(fisher(strayed, of, *counts[own]))
            rows.append((f"`{name}`", f"{strayed} of {of}", p)[: 3 if tested else 2])
        parts += [f"### {scenario}"] if len(results.scenarios) > 1 else []
        parts.append(table(("policy", "trainings that stray", f"p against `{own}`")[: 3 if tested else 2], rows))
    return [f"## Strays\n\n{_strays_note(results.settings)}", *parts] if parts else []


def _strays_note(settings: Mapping[str, Any]) -> str:
    stated, behind = settings.get("held"), settings.get("behind")
    test = "p: Fisher's exact test, two-sided; each stands by itself."
    if behind:
        return (
            f"A training strays where its mean AoU is more than {100 * float(behind):g}% above the lowest of its "
            f"algorithm, of whichever variant, on the scenario; so this may change while trainings are added. {test}"
        )
    if not isinstance(stated, list):
        return (
            "A training strays where it does not hold the commonest set of held devices on its scenario. The trainings "
            "say themselves what is common, so that a test would be circular; with `held` in the study's file, stated "
            "before the runs, there is one."
        )
    devices = "device" if len(stated) == 1 else "all of the devices"
    return f"A training strays where it does not hold {devices} {', '.join(map(str, stated))}. {test}"
