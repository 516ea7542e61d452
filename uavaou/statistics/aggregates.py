"""Aggregates over seeds, missions and scenarios, as Agarwal et al. (NeurIPS 2021, arXiv 2108.13264) define them.

Scores are ages: **lower is better**, unlike the returns of that paper. The scores of a policy are a mapping from task
(a scenario) to an array (S, M), a row for each training seed and a column for each mission. A planner has one row.

Intervals are percentiles of a stratified bootstrap. Each resample draws, within each task, seeds with replacement and
missions with replacement. All seeds and policies play the same missions, so one draw of missions serves them all (the
crossed bootstrap of Owen, Annals of Applied Statistics 1(2), 2007), and comparisons are paired by mission. With one
mission a run this is the bootstrap of Agarwal et al. and of rliable: runs resampled within each task.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from uavaou.arrays import Floats
from uavaou.statistics.intervals import UPPER, Band, Interval

Scores = Mapping[str, ArrayLike]  # task -> (S, M)

RESAMPLES = 2000
_SEED = 20_240_502  # any fixed number: the same scores give the same interval
_ENTRIES_AT_ONCE = 4_000_000  # resampling weights held in memory together
_CUT = 0.25  # of the scores, left out at each end of the interquartile mean


def geometric_mean(values: Sequence[float]) -> float:
    """The geometric mean of ages or of their ratios; 0 where one of them is, and exact for one alone."""
    if len(values) == 1:
        return values[0]
    return math.exp(math.fsum(map(math.log, values)) / len(values)) if min(values) > 0 else 0.0


def interquartile_mean(scores: Scores) -> Interval:
    """The mean of the middle half of all scores, seeds x missions x tasks.

    Tasks are pooled, so their scores must be of comparable size: divide by a reference of each task first.

    Args:
        scores: task -> (S, M).

    Raises:
        ValueError: no scores, scores that are not finite or no (S, M) arrays.
    """
    tables = _tables(scores)
    return _interval(lambda draws: _trimmed_means(tables, draws), [tables])


def probability_of_improvement(x: Scores, y: Scores) -> Interval:
    """P(X < Y) + P(X = Y) / 2 for a score of x and one of y in the same task, mean over the tasks.

    AoU is better when lower, so a value above 0.5 means that x is better. Each score is one mission of one seed. This
    is the Mann-Whitney statistic of each task over S M x S' M' pairs.

    Raises:
        ValueError: as :func:`interquartile_mean`, or other tasks in x than in y.
    """
    if sorted(x) != sorted(y):
        raise ValueError(f"scores in the tasks {sorted(x)} cannot be compared with scores in {sorted(y)}")
    tables = [_tables(x), _tables(y)]
    pairs = [_Pairs(*pair) for pair in zip(*tables, strict=True)]

    def wins(of_x: _Draws, of_y: _Draws) -> Floats:
        return np.asarray(np.mean([pair.wins(*draws) for pair, *draws in zip(pairs, of_x, of_y, strict=True)], axis=0))

    return _interval(wins, tables)


def performance_profile(scores: Scores, thresholds: ArrayLike) -> Band:
    """The share of all scores at or below each threshold: the further up and left, the better.

    Args:
        scores: task -> (S, M), of comparable size.
        thresholds: (T,), in the unit of the scores.

    Raises:
        ValueError: as :func:`interquartile_mean`.
    """
    tables = _tables(scores)
    values = np.concatenate([table.ravel() for table in tables])  # (n,)
    order = np.argsort(values, kind="stable")
    place = np.searchsorted(values[order], np.asarray(thresholds, dtype=np.float64), side="right")  # (T,)

    def shares(draws: _Draws) -> Floats:
        return np.asarray(_cumulative(_pooled(draws)[:, order])[:, place] / len(values))  # (r, T)

    return _bootstrap(shares, [tables])


# -- resampling ----------------------------------------------------------------------------------------

# For each task, how often each seed, (r, S), and each mission, (r, M), is drawn in each of r resamples.
_Draws = Sequence[tuple[Floats, Floats]]


def _tables(scores: Scores) -> list[Floats]:
    """The scores of each task in the tasks' order, checked, (S, M) each."""
    tables = [np.asarray(scores[task], dtype=np.float64) for task in sorted(scores)]
    if not tables:
        raise ValueError("no scores: expected at least one task")
    for task, table in zip(sorted(scores), tables, strict=True):
        if table.ndim != 2 or table.size == 0:
            raise ValueError(f"scores of task '{task}' have shape {table.shape}: expected (seeds, missions)")
        if not np.isfinite(table).all():
            raise ValueError(f"scores of task '{task}' must be finite")
    return tables


def _interval(statistic: Callable[..., Floats], policies: Sequence[list[Floats]]) -> Interval:
    found = _bootstrap(statistic, policies).only
    alone = all(table.size == 1 for tables in policies for table in tables)
    return Interval(found.value, np.nan, np.nan) if alone else found


def _bootstrap(statistic: Callable[..., Floats], policies: Sequence[list[Floats]]) -> Band:
    """The statistic of the scores as they are, and its percentiles over the resamples.

    Args:
        statistic: from the draws of each policy to a value for each resample, (r, ...).
        policies: the scores of each policy that the statistic takes, (S, M) a task.
    """
    once = [[tuple(np.ones((1, n)) for n in table.shape) for table in tables] for tables in policies]
    value = statistic(*once)[0]
    drawn = np.concatenate([statistic(*draws) for draws in _resamples(policies)])  # (RESAMPLES, ...)
    low, high = np.quantile(drawn, [1 - UPPER, UPPER], axis=0)
    return Band(value, low, high)


def _resamples(policies: Sequence[list[Floats]]) -> Iterator[list[_Draws]]:
    """The draws of every policy, some resamples at a time."""
    drawn = [[_draw(table.shape, side, t) for t, table in enumerate(tables)] for side, tables in enumerate(policies)]
    entries = max(sum(table.size for table in tables) for tables in policies)
    step = max(1, _ENTRIES_AT_ONCE // entries)
    for start in range(0, RESAMPLES, step):
        part = slice(start, start + step)
        yield [[(seeds[part], missions[part]) for seeds, missions in draws] for draws in drawn]


def _draw(shape: tuple[int, ...], side: int, task: int) -> tuple[Floats, Floats]:
    """How often each seed and each mission of a task is drawn, (RESAMPLES, S) and (RESAMPLES, M).

    ``side`` numbers the policies of a comparison: they share the draw of missions, and each has its own of seeds.
    """
    counts = []
    for n, key in zip(shape, ((0, side, task), (1, task)), strict=True):
        rng = np.random.default_rng([_SEED, *key])
        counts.append(rng.multinomial(n, np.full(n, 1 / n), RESAMPLES).astype(np.float64))
    return counts[0], counts[1]


# -- statistics of weighted scores ---------------------------------------------------------------------


def _weights(seeds: Floats, missions: Floats) -> Floats:
    """How often each score of one task was drawn, (r, S M)."""
    return np.asarray((seeds[:, :, None] * missions[:, None, :]).reshape(len(seeds), -1))


def _pooled(draws: _Draws) -> Floats:
    """How often each score of all tasks was drawn, (r, n)."""
    return np.concatenate([_weights(*draw) for draw in draws], axis=1)


def _cumulative(weights: Floats) -> Floats:
    """How many of the first 0, 1, ... n scores were drawn, (r, n + 1)."""
    total = np.zeros((len(weights), weights.shape[1] + 1))
    np.cumsum(weights, axis=1, out=total[:, 1:])
    return total


def _trimmed_means(tables: list[Floats], draws: _Draws) -> Floats:
    """The mean of the drawn scores without a quarter, rounded down, at each end, (r,)."""
    values = np.concatenate([table.ravel() for table in tables])  # (n,)
    order = np.argsort(values, kind="stable")
    first, last = int(_CUT * len(values)), len(values) - int(_CUT * len(values))
    reached = np.clip(_cumulative(_pooled(draws)[:, order]), first, last)  # (r, n + 1)
    return np.asarray(np.diff(reached, axis=1) @ values[order] / (last - first))


class _Pairs:
    """All pairs of a score of x with a score of y in one task."""

    def __init__(self, x: Floats, y: Floats) -> None:
        self._order = np.argsort(x, axis=None, kind="stable")
        ordered = x.ravel()[self._order]
        self._below = np.searchsorted(ordered, y.ravel(), side="left")  # (n_y,) scores of x below each of y
        self._up_to = np.searchsorted(ordered, y.ravel(), side="right")
        self._pairs = x.size * y.size

    def wins(self, of_x: tuple[Floats, Floats], of_y: tuple[Floats, Floats]) -> Floats:
        """The share of pairs in which x is lower, ties as halves, (r,)."""
        counted = _cumulative(_weights(*of_x)[:, self._order])  # (r, n_x + 1)
        wins = (counted[:, self._below] + counted[:, self._up_to]) / 2  # (r, n_y)
        return np.asarray((wins * _weights(*of_y)).sum(axis=1) / self._pairs)
