"""How the mean signal falls with distance, beside free space: the path-loss exponent and the line of sight.

At a slant distance d from a UAV at altitude H, the mean power gain is beta_0 d^(-eta) 10^(-(X + L) / 10), with
L = p L_LoS + (1 - p) L_NLoS, p = 1 / (1 + a exp(-b (theta - a))), sin theta = H / d (Al-Hourani, Kandeepan and Lardner,
"Optimal LAP Altitude for Maximum Coverage", 2014; a mean over the two states). Beside a constant it depends on
d^2 / H^2 alone: all that follows is in terms of this ratio, and of how many times weaker the signal is than right above
the device. In the paper's channel the two are equal.
"""

import math

import numpy as np

from uavaou.arrays import Floats
from uavaou.scenario import Scenario
from uavaou.world.compiled import compiled

_HALVINGS = 100  # of an interval of logarithms: to the last bit


def sight_of(scenario: Scenario) -> Floats:
    """Return (a, b, L_LoS, L_NLoS) of the line of sight, (4,), or (0,) without one."""
    sight = scenario.line_of_sight
    return np.empty(0) if sight is None else np.array([sight.a, sight.b, sight.loss_los_db, sight.loss_nlos_db])


def loss_above(scenario: Scenario) -> Floats:
    """Return how many times weaker than at 1 m, but for the excess loss, the mean signal is right below, (U,)."""
    loss: Floats = (scenario.altitudes**2) ** (scenario.path_loss_exponent / 2)
    sight = sight_of(scenario)
    return loss * 10.0 ** (_sight_loss(1.0, sight) / 10) if len(sight) else loss


def weakened(scenario: Scenario, ratio: Floats) -> Floats:
    """Return how many times weaker than right above a device the mean signal is at d^2 / H^2 = ``ratio`` >= 1."""
    sight = sight_of(scenario)
    if not len(sight):
        return ratio if scenario.path_loss_exponent == 2 else ratio ** (scenario.path_loss_exponent / 2)
    return _weakened(np.ascontiguousarray(ratio).ravel(), scenario.path_loss_exponent, sight).reshape(ratio.shape)


def ratio_at(scenario: Scenario, weaker: Floats) -> Floats:
    """Return the d^2 / H^2 at which the mean signal is so many times ``weaker`` than right above, elementwise.

    It is the inverse of :func:`weakened`; below 1, and NaN, where ``weaker`` is.
    """
    sight = sight_of(scenario)
    if not len(sight):
        return weaker if scenario.path_loss_exponent == 2 else weaker ** (2 / scenario.path_loss_exponent)
    return _ratio_at(np.ascontiguousarray(weaker).ravel(), scenario.path_loss_exponent, sight).reshape(weaker.shape)


@compiled
def _sight_loss(sine: float, sight: Floats) -> float:
    """L in dB at an elevation."""
    elevation = math.degrees(math.asin(min(sine, 1.0)))
    seen = 1.0 / (1.0 + sight[0] * math.exp(-sight[1] * (elevation - sight[0])))
    loss: float = seen * sight[2] + (1.0 - seen) * sight[3]
    return loss


@compiled
def weakening(ratio: float, exponent: float, sight: Floats) -> float:
    """Do what :func:`weakened` does for one ratio."""
    weaker: float = ratio ** (0.5 * exponent)
    if len(sight):
        weaker *= 10.0 ** ((_sight_loss(1.0 / math.sqrt(ratio), sight) - _sight_loss(1.0, sight)) / 10.0)
    return weaker


@compiled
def _weakened(ratio: Floats, exponent: float, sight: Floats) -> Floats:
    weaker = np.empty_like(ratio)
    for k in range(len(ratio)):
        weaker[k] = weakening(ratio[k], exponent, sight)
    return weaker


@compiled
def _ratio_at(weaker: Floats, exponent: float, sight: Floats) -> Floats:
    ratio = weaker.copy()
    for k in range(len(weaker)):
        if not 1.0 < weaker[k] < np.inf:
            continue
        # The line of sight only adds to the loss.
        low, high = 0.0, 2.0 / exponent * math.log(weaker[k])
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if weakening(math.exp(middle), exponent, sight) <= weaker[k]:
                low = middle
            else:
                high = middle
        ratio[k] = math.exp(low)
    return ratio
