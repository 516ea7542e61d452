"""Each training of a study by itself: its level, and when it converged."""

from uavaou.evaluation.flights import VALIDATION
from uavaou.experiments.results import StudyResults
from uavaou.reports.claims import SMOOTHED, WITHIN, converged, smooth
from uavaou.reports.markdown import rounded, table

_HEAD = ("policy", "seed", "mean AoU (slots)", "level (slots)", "converged at")
_NOTE = f"""\
Level: the lowest validation AoU of the training, averaged over {SMOOTHED} evaluations. Converged at: the training slots
from which on that average stays within {WITHIN:.0%} of the level."""


def trainings_section(results: StudyResults) -> list[str]:
    """The page's part on each training; nothing where no training has validations."""
    parts = []
    for scenario in results.scenarios:
        rows = [row for variant in results.algorithms for row in _rows(results, variant, scenario)]
        parts += [f"### {scenario}"] if rows and len(results.scenarios) > 1 else []
        parts += [table(_HEAD, rows)] if rows else []
    return [f"## Trainings\n\n{_NOTE}", *parts] if parts else []


def _rows(results: StudyResults, variant: str, scenario: str) -> list[tuple[str, ...]]:
    found: list[tuple[str, ...]] = []
    trainings = results.trainings(variant, scenario)
    for run, one in zip(results.curves(VALIDATION, variant, scenario), trainings.itertuples(), strict=False):
        aou = run["mean_aou_slots"]
        moment, level = converged(aou), rounded(float(smooth(aou).min()), 4)
        at = f"{int(run['x'][moment.place]):,} slots" if moment.happened else "never"
        found.append((f"`{variant}`", str(one.seed), rounded(float(one.mean_aou_slots), 4), level, at))
    return found
