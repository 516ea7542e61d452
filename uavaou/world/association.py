"""Which UAV collects which device: constraints (Rate) and (Association) of the paper hold by construction."""

from dataclasses import dataclass

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.world.ages import age_by_estimate
from uavaou.world.compiled import compiled


@dataclass(frozen=True)
class Association:
    """The outcome of one slot in N missions."""

    collected_by: Ints  # (N, I), the u with alpha_iu = 1; -1 for none
    rejected_rate: Ints  # (N,), selections below R_min
    rejected_association: Ints  # (N,), selections that lost to a better rate
    rejected_capacity: Ints  # (N,), selections beyond uplinks_per_slot


def associate(in_range: Bools, snr: Floats, selected: Bools | None) -> Association:
    """Assign each device to the candidate with the largest rate; a tie goes to the lowest u.

    The bandwidth of a device is the same towards every UAV, so the largest SNR gives the largest rate.

    Args:
        in_range: R_iu >= R_min, (N, U, I).
        snr: Gamma_iu, (N, U, I); read only in range.
        selected: the devices that each UAV selected, (N, U, I); None selects every device in range.
    """
    missions, _, devices = in_range.shape
    collected_by = np.full((missions, devices), -1, dtype=np.int64)  # (N, I)
    rejected_rate, rejected_association = np.zeros((2, missions), dtype=np.int64)  # (N,) each
    candidates = in_range if selected is None else selected
    _associate(in_range, snr, candidates, collected_by, rejected_rate, rejected_association)
    return Association(collected_by, rejected_rate, rejected_association, np.zeros(missions, dtype=np.int64))


def within_capacity(offered: Bools, limit: int, first: Floats, second: Floats) -> Bools:
    """Return which devices each UAV keeps of those offered, (N, U, I): the ``limit`` that come first.

    Args:
        offered: selected and in range, (N, U, I).
        limit: devices that a UAV serves in a slot.
        first: what decides, the larger comes first, (N, U, I).
        second: what decides between equal ones; between equals in both, the lowest i comes first.
    """
    kept = np.zeros_like(offered)
    _keep(offered, limit, first, second, kept)
    return kept


def oldest_within_capacity(
    offered: Bools, limit: int, slot: int, known: Ints, period: Ints, snr: Floats, bandwidth: Floats
) -> Bools:
    """Return what :func:`within_capacity` does by the estimate of the age, and then by the rate, (N, U, I).

    Args:
        offered, limit: as there.
        slot: t.
        known: the latest slot of a collection of each device that each UAV knows of, (N, U, I).
        period, bandwidth: of the devices, (L, I) slots and Hz.
        snr: Gamma_iu, (N, U, I).
    """
    age, rates = np.zeros((2, *offered.shape))  # (N, U, I) slots, bit/s; of devices that are offered alone
    _weigh(offered, slot, known, period, snr, bandwidth, age, rates)
    return within_capacity(offered, limit, age, rates)


_estimated_age = compiled(age_by_estimate)  # here, where a compiled function calls it


@compiled
def _weigh(
    offered: Bools, slot: int, known: Ints, period: Ints, snr: Floats, bandwidth: Floats, age: Floats, rates: Floats
) -> None:
    missions, uavs, devices = offered.shape
    for n in range(missions):
        layout = min(n, len(period) - 1)
        for u in range(uavs):
            for i in range(devices):
                if offered[n, u, i]:
                    age[n, u, i] = _estimated_age(slot, known[n, u, i], period[layout, i])
                    rates[n, u, i] = bandwidth[layout, i] * np.log2(1.0 + snr[n, u, i])


@compiled
def _keep(offered: Bools, limit: int, first: Floats, second: Floats, kept: Bools) -> None:
    missions, uavs, devices = offered.shape
    for n in range(missions):
        for u in range(uavs):
            for _ in range(limit):
                best = -1
                for i in range(devices):
                    if not offered[n, u, i] or kept[n, u, i]:
                        continue
                    ahead = best < 0 or first[n, u, i] > first[n, u, best]
                    tie = best >= 0 and first[n, u, i] == first[n, u, best]
                    if ahead or (tie and second[n, u, i] > second[n, u, best]):
                        best = i
                if best < 0:
                    break
                kept[n, u, best] = True


@compiled
def _associate(
    in_range: Bools, snr: Floats, asked: Bools, collected_by: Ints, rejected_rate: Ints, rejected_association: Ints
) -> None:
    missions, uavs, devices = in_range.shape
    best = np.empty(devices)
    for n in range(missions):
        best[:] = -1.0  # SNRs are never negative
        offered = 0
        for u in range(uavs):
            for i in range(devices):
                candidate = asked[n, u, i] and in_range[n, u, i]
                offered += candidate
                rejected_rate[n] += asked[n, u, i] and not candidate
                wins = candidate and snr[n, u, i] > best[i]  # strictly: the lower u keeps a tie
                best[i] = snr[n, u, i] if wins else best[i]
                collected_by[n, i] = u if wins else collected_by[n, i]
        rejected_association[n] = offered
        for i in range(devices):
            rejected_association[n] -= collected_by[n, i] >= 0
