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


def associate(in_range: Bools, snr: Floats, selected: Bools | None, kept: Bools | None = None) -> Association:
    """Assign each device to the candidate with the largest rate; a tie goes to the lowest u.

    The bandwidth of a device is the same towards every UAV, so the largest SNR gives the largest rate.

    Args:
        in_range: R_iu >= R_min, (N, U, I).
        snr: Gamma_iu, (N, U, I); read only in range.
        selected: the devices that each UAV selected, (N, U, I); None selects every device in range.
        kept: those that it can serve of the selected ones in range, (N, U, I); None for all.
    """
    missions, _, devices = in_range.shape
    collected_by = np.empty((missions, devices), dtype=np.int64)  # (N, I)
    rejected = np.empty((3, missions), dtype=np.int64)  # by the rate, the association and the capacity
    asked = in_range if selected is None else selected
    _associate(in_range, snr, asked, asked if kept is None else kept, collected_by, rejected)
    return Association(collected_by, *rejected)


def within_capacity(offered: Bools, limit: int, first: Floats, second: Floats) -> Bools:
    """Return which devices each UAV keeps of those offered, (N, U, I): the ``limit`` that come first.

    Args:
        offered: selected and in range, (N, U, I).
        limit: devices that a UAV serves in a slot.
        first: what decides, the larger comes first, (N, U, I).
        second: what decides between equal ones; between equals in both, the lowest i comes first.
    """
    kept = np.empty(offered.shape, dtype=np.bool_)  # (N, U, I)
    _keep_first(offered, limit, first, second, kept)
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
    kept = np.empty(offered.shape, dtype=np.bool_)  # (N, U, I)
    _keep_oldest(offered, limit, slot, known, period, snr, bandwidth, kept)
    return kept


_estimated_age = compiled(age_by_estimate)  # here, where a compiled function calls it


@compiled
def _keep(offered: Ints, limit: int, first: Floats, second: Floats, kept: Bools) -> None:
    """Write what a UAV keeps, (I,), of the devices with these numbers, which are more than it can serve."""
    kept[:] = False
    for _ in range(limit):
        best = -1
        for i in offered:
            if kept[i]:
                continue
            ahead = best < 0 or first[i] > first[best]
            tie = best >= 0 and first[i] == first[best]
            if ahead or (tie and second[i] > second[best]):
                best = i
        kept[best] = True


@compiled
def _keep_first(offered: Bools, limit: int, first: Floats, second: Floats, kept: Bools) -> None:
    kept[:] = offered
    for n in range(offered.shape[0]):
        for u in range(offered.shape[1]):
            numbers = np.flatnonzero(offered[n, u])
            if len(numbers) > limit:
                _keep(numbers, limit, first[n, u], second[n, u], kept[n, u])


@compiled
def _keep_oldest(
    offered: Bools, limit: int, slot: int, known: Ints, period: Ints, snr: Floats, bandwidth: Floats, kept: Bools
) -> None:
    missions, uavs, devices = offered.shape
    kept[:] = offered
    age, rates = np.empty(devices), np.empty(devices)  # slots and bit/s of the devices that a UAV is offered
    numbers = np.empty(devices, dtype=np.int64)  # of those
    for n in range(missions):
        layout = min(n, len(period) - 1)
        for u in range(uavs):
            count = 0
            for i in range(devices):
                numbers[count] = i
                count += offered[n, u, i]
            if count <= limit:
                continue
            for i in numbers[:count]:
                age[i] = _estimated_age(slot, known[n, u, i], period[layout, i])
                rates[i] = bandwidth[layout, i] * np.log2(1.0 + snr[n, u, i])
            _keep(numbers[:count], limit, age, rates, kept[n, u])


@compiled
def _associate(in_range: Bools, snr: Floats, asked: Bools, kept: Bools, collected_by: Ints, rejected: Ints) -> None:
    missions, uavs, devices = in_range.shape
    best = np.empty(devices)
    for n in range(missions):
        best[:], collected_by[n] = -1.0, -1  # SNRs are never negative
        out_of_range, candidates, beyond = 0, 0, 0
        for u in range(uavs):
            for i in range(devices):
                offered = asked[n, u, i] and in_range[n, u, i]
                candidate = offered and kept[n, u, i]
                out_of_range += asked[n, u, i] and not offered
                candidates += candidate
                beyond += offered and not candidate
                wins = candidate and snr[n, u, i] > best[i]  # strictly: the lower u keeps a tie
                best[i] = snr[n, u, i] if wins else best[i]
                collected_by[n, i] = u if wins else collected_by[n, i]
        for i in range(devices):
            candidates -= collected_by[n, i] >= 0
        rejected[0, n], rejected[1, n], rejected[2, n] = out_of_range, candidates, beyond
