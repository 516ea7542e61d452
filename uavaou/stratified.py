"""Aggregates over seeds, missions and scenarios, as Agarwal et al. (NeurIPS 2021, arXiv 2108.13264) ask for them.

Scores are ages: **lower is better**, unlike the returns of that paper. What one policy did is a mapping
from task (a scenario) to an array (S, M), a row for each training seed, a column for each mission. A planner is not
trained and has one row.

Intervals are those of a stratified bootstrap with percentiles. In each resample, and within each task: seeds
are drawn with replacement, and missions are drawn with replacement within the task. All seeds and policies
play the same missions, so that one draw of missions serves them all (the crossed bootstrap of Owen, Annals of
Applied Statistics 1(2), 2007), and comparisons are paired by mission. With one mission a run, or with the
mean of each run as its only column, this is the bootstrap of Agarwal et al.: runs resampled within each task.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Scores = Mapping[str, ArrayLike]  # task -> (S, M)

RESAMPLES = 2000
_SEED = 20_240_502  # any fixed number: a table made twice from the same figures must not differ
_ENTRIES_AT_ONCE = 4_000_000  # resampling weights held in memory together
_CUT = 0.25  # of the scores, left out at each end of the interquartile mean


class Estimate(NamedTuple):
    """A figure and its interval; low and high are nan where one score alone says nothing of its spread."""

    value: float
    low: float
    high: float


class Profile(NamedTuple):
    """A performance profile at T thresholds, between 0 and 1."""

    share: Floats  # (T,)
    low: Floats  # (T,)
    high: Floats  # (T,)


def interquartile_mean(scores: Scores, confidence: float = 0.95) -> Estimate:
    """The mean of the middle half of all scores, seeds x missions x tasks.

    Tasks are pooled, so their scores must be of comparable size: divide by a reference of each task first.

    Args:
        scores: task -> (S, M).
        confidence: of the interval, between 0 and 1.

    Raises:
        ValueError: no scores, scores that are not finite or no (S, M) arrays, or a bad confidence.
    """
    tables = _tables(scores)
    return _estimate(lambda draws: _trimmed_means(tables, draws), [tables], confidence)


def mean_score(scores: Scores, confidence: float = 0.95) -> Estimate:
    """The mean over tasks of the mean over seeds and missions; raises as :func:`interquartile_mean`."""
    tables = _tables(scores)
    return _estimate(lambda draws: np.mean(_task_means(tables, draws), axis=0), [tables], confidence)


def probability_of_improvement(x: Scores, y: Scores, confidence: float = 0.95) -> Estimate:
    """P(X < Y) + P(X = Y) / 2 for a score of x and one of y in the same task, mean over the tasks.

    AoU is better when lower, so a value above 0.5 says that x is the better one. Each score is one mission
    of one seed; this is the Mann-Whitney statistic of each task over S M x S' M' pairs.

    Raises:
        ValueError: as :func:`interquartile_mean`, or other tasks in x than in y.
    """
    tables = _of_same_tasks(x, y)
    pairs = [_Pairs(*pair) for pair in zip(*tables, strict=True)]

    def wins(of_x: _Draws, of_y: _Draws) -> Floats:
        each = [pair.wins(a, b) for pair, a, b in zip(pairs, of_x, of_y, strict=True)]
        shares: Floats = np.mean(each, axis=0)  # (r,)
        return shares

    return _estimate(wins, tables, confidence)


def performance_profile(scores: Scores, thresholds: ArrayLike, confidence: float = 0.95) -> Profile:
    """The share of all scores at or below each threshold: the further up and left, the better.

    Args:
        scores: task -> (S, M), of comparable size.
        thresholds: (T,), in the unit of the scores.
        confidence: of the band at each threshold, between 0 and 1.

    Raises:
        ValueError: as :func:`interquartile_mean`.
    """
    tables = _tables(scores)
    values = np.concatenate([table.ravel() for table in tables])  # (n,)
    order = np.argsort(values, kind="stable")
    place = np.searchsorted(values[order], np.asarray(thresholds, dtype=np.float64), side="right")  # (T,)

    def shares(draws: _Draws) -> Floats:
        reached: Floats = _cumulative(_pooled(draws)[:, order])[:, place] / len(values)  # (r, T)
        return reached

    value, low, high = _bootstrap(shares, [tables], confidence)
    return Profile(value, low, high)


# -- resampling ----------------------------------------------------------------------------------------

# How often each score of each task stands in each of r resamples: the (r, S) of seeds and (r, M) of missions.
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


def _of_same_tasks(x: Scores, y: Scores) -> list[list[Floats]]:
    if sorted(x) != sorted(y):
        raise ValueError(f"scores in the tasks {sorted(x)} cannot be compared with scores in {sorted(y)}")
    return [_tables(x), _tables(y)]


def _estimate(figure: Callable[..., Floats], policies: Sequence[list[Floats]], confidence: float) -> Estimate:
    value, low, high = _bootstrap(figure, policies, confidence)
    if all(table.size == 1 for tables in policies for table in tables):
        return Estimate(float(value), np.nan, np.nan)
    return Estimate(float(value), float(low), float(high))


def _bootstrap(
    figure: Callable[..., Floats], policies: Sequence[list[Floats]], confidence: float
) -> tuple[Floats, Floats, Floats]:
    """The figure of the scores as they are, and its percentiles over the resamples, (...) each.

    Args:
        figure: from the draws of each policy to the figure of each resample, (r, ...).
        policies: the scores of each policy that the figure takes, (S, M) a task.
        confidence: between 0 and 1.
    """
    if not 0 < confidence < 1:
        raise ValueError(f"confidence = {confidence}: must lie between 0 and 1")
    once = [[tuple(np.ones((1, n)) for n in table.shape) for table in tables] for tables in policies]
    value = figure(*once)[0]
    drawn = np.concatenate([figure(*draws) for draws in _resamples(policies)])  # (RESAMPLES, ...)
    tail = (1 - confidence) / 2
    low, high = np.quantile(drawn, [tail, 1 - tail], axis=0)
    return value, low, high


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

    ``side`` tells the policies of a comparison apart: their seeds are drawn independently, their missions are
    the same ones.
    """
    counts = []
    for n, key in zip(shape, ((0, side, task), (1, task)), strict=True):
        rng = np.random.default_rng([_SEED, *key])
        counts.append(rng.multinomial(n, np.full(n, 1 / n), RESAMPLES).astype(np.float64))
    return counts[0], counts[1]


# -- figures of weighted scores ------------------------------------------------------------------------


def _weights(seeds: Floats, missions: Floats) -> Floats:
    """How often each score of one task was drawn, (r, S M)."""
    weights: Floats = (seeds[:, :, None] * missions[:, None, :]).reshape(len(seeds), -1)
    return weights


def _pooled(draws: _Draws) -> Floats:
    """How often each score of all tasks was drawn, (r, n)."""
    return np.concatenate([_weights(*draw) for draw in draws], axis=1)


def _cumulative(weights: Floats) -> Floats:
    """How many of the first 0, 1, ... n scores were drawn, (r, n + 1)."""
    total = np.zeros((len(weights), weights.shape[1] + 1))
    np.cumsum(weights, axis=1, out=total[:, 1:])
    return total


def _trimmed_means(tables: list[Floats], draws: _Draws) -> Floats:
    """The mean of what is left after a quarter of the drawn scores, rounded down, goes at each end, (r,)."""
    values = np.concatenate([table.ravel() for table in tables])  # (n,)
    order = np.argsort(values, kind="stable")
    first, last = int(_CUT * len(values)), len(values) - int(_CUT * len(values))
    reached = np.clip(_cumulative(_pooled(draws)[:, order]), first, last)  # (r, n + 1)
    means: Floats = np.diff(reached, axis=1) @ values[order] / (last - first)
    return means


def _task_means(tables: list[Floats], draws: _Draws) -> Floats:
    """The mean of each task, (tasks, r)."""
    return np.stack(
        [
            ((seeds @ table) * missions).sum(axis=1) / table.size
            for table, (seeds, missions) in zip(tables, draws, strict=True)
        ]
    )


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
        shares: Floats = (wins * _weights(*of_y)).sum(axis=1) / self._pairs
        return shares
