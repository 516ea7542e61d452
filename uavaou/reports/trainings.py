"""Each training of a study by itself: its level, and when it converged."""

from pathlib import Path

from uavaou.csv_tables import write_csv
from uavaou.reports.markdown import rounded, table
from uavaou.reports.training_claims import SMOOTHED, WITHIN, converged, smooth
from uavaou.studies.folder import PartKey
from uavaou.studies.results import StudyResults

COLUMNS = ("variant", "scenario", "seed", "mean_aou_slots", "level_slots", "converged_slots")
_HEAD = ("policy", "seed", "mean AoU (slots)", "level (slots)", "converged at")
_NOTE = f"""\
Level: the lowest validation AoU of the training, averaged over {SMOOTHED} evaluations. Converged at: the training slots
from which on that average stays within {WITHIN:.0%} of the level."""


def write_trainings(path: Path, results: StudyResults) -> None:
    """Write a row for each training."""
    write_csv(path, COLUMNS, (_row(results, key) for key in _keys(results)))


def _keys(results: StudyResults) -> list[PartKey]:
    keys = [key for key in results.parts if key.seed is not None and "validation" in results.parts[key]]
    order = [*results.algorithms]
    return sorted(keys, key=lambda key: (list(results.scenarios).index(key.scenario), order.index(key.variant)))


def _row(results: StudyResults, key: PartKey) -> list[str]:
    run = results.table("validation", *key)
    moment = converged(run["mean_aou_slots"])
    at = str(int(run["slots"][moment.place])) if moment.happened else ""
    level = f"{smooth(run['mean_aou_slots']).min():.6g}"
    mean = results.cell(key, "mean_aou_slots")
    return [key.variant, key.scenario, str(key.seed), mean, level, at]


def trainings_section(results: StudyResults) -> list[str]:
    """The page's part on each training; nothing where no training has validations."""
    keys = _keys(results)
    parts = [f"## Trainings\n\n{_NOTE}"] if keys else []
    for scenario in dict.fromkeys(key.scenario for key in keys):
        if len(results.scenarios) > 1:
            parts.append(f"### {scenario}")
        rows = [_cells(_row(results, key)) for key in keys if key.scenario == scenario]
        parts.append(table(_HEAD, rows))
    return parts


def _cells(row: list[str]) -> tuple[str, ...]:
    variant, _, seed, mean, level, at = row
    told = f"{int(at):,} slots" if at else "never"
    return f"`{variant}`", seed, rounded(float(mean), 4), rounded(float(level), 4), told
