"""95 % intervals: one type, and one rule for which interval is used where.

=====================================  ==========================================  ====================
the values are                         the interval is                             module
=====================================  ==========================================  ====================
missions of one policy                 a percentile bootstrap over the missions    ``missions``
trainings (seeds), one value each      Student's; Welch's on logarithms for a      ``trainings``
                                       ratio, Student's of the logarithm of the
                                       mean for a figure's curves
missions of all seeds and scenarios    a stratified bootstrap, as rliable's        ``aggregates``
(IQM, probability of improvement,
performance profile)
=====================================  ==========================================  ====================

The rule holds for the README, study pages, claims and figures alike. Trainings are few and missions are many: over
five log-normal values, 95 % percentile intervals of a bootstrap hold the true mean in about 82 % of cases and Student's
in about 94 %. The missions of one training say nothing about another training, so each training counts with its mean.
"""

from uavaou.statistics.aggregates import (
    geometric_mean,
    interquartile_mean,
    performance_profile,
    probability_of_improvement,
)
from uavaou.statistics.intervals import Band, Interval
from uavaou.statistics.missions import band_over_missions, interval_over_missions
from uavaou.statistics.trainings import (
    band_over_trainings,
    interval_over_trainings,
    log_band_over_trainings,
    mean_of_tasks,
    ratio_of_trainings,
)

__all__ = [
    "Band",
    "Interval",
    "band_over_missions",
    "band_over_trainings",
    "geometric_mean",
    "interquartile_mean",
    "interval_over_missions",
    "interval_over_trainings",
    "log_band_over_trainings",
    "mean_of_tasks",
    "performance_profile",
    "probability_of_improvement",
    "ratio_of_trainings",
]
