"""Counts of an outcome in two groups: Fisher's exact test, and whether more trials can still change its result."""

from itertools import product

import numpy as np
from scipy.stats import fisher_exact

LEVEL = 0.05  # of a test


def fisher(first: int, of_first: int, second: int, of_second: int) -> float:
    """The two-sided p-value of Fisher's exact test (Fisher 1922) that an outcome is as likely in both groups.

    Args:
        first, second: how often it happened in each group.
        of_first, of_second: trials of each group.
    """
    table = np.array([[first, of_first - first], [second, of_second - second]])
    return float(fisher_exact(table).pvalue)


def is_decided(first: int, of_first: int, second: int, of_second: int, trials: int) -> bool:
    """Whether no outcome of the trials that are left changes on which side of ``LEVEL`` the final p-value lies.

    A stop by this rule costs no error probability: the test is that of all ``trials``, whose verdict is known.

    Args:
        first, of_first, second, of_second: as :func:`fisher`'s, so far.
        trials: of each group, at the end.
    """
    more = product(range(trials - of_first + 1), range(trials - of_second + 1))
    verdicts = {fisher(first + a, trials, second + b, trials) < LEVEL for a, b in more}
    return len(verdicts) == 1
