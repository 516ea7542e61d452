"""The compiled kernel that scores a rule with free numbers: whole missions on drawn fading.

The rule is that of :class:`~uavaou.planners.local_greedy.LocalGreedy` with any pull: UAV u makes the allowed move to
the cell c with the largest sum_i A_ui pull_ui(c). Whether a device is in range is drawn against the coverage
probability of the cell, which is the exact law of the channel. Which of two UAVs in range collects a device does not
affect its age.

Compiled helpers take arrays, not the tuple: each access to a field of a tuple counts references, and a slot has many.
"""

from typing import NamedTuple

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.scenario import Layout, Scenario
from uavaou.world.compiled import compiled_fast
from uavaou.world.coverage import cell_coverage
from uavaou.world.flight import Flight, first_step, grid_cells, neighbours

_LEAST = 0.01  # coverage probabilities below are taken as 0
_GOLDEN, _SPREAD = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xD1342543DE82EF95)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_RIGHT_11, _RIGHT_27, _RIGHT_30, _RIGHT_31 = np.uint64(11), np.uint64(27), np.uint64(30), np.uint64(31)


class Chart(NamedTuple):
    """What a layout says of missions. It is a NamedTuple because Numba takes one as an argument."""

    near: Ints  # (U, C, J) devices in reach of a cell
    probability: Floats  # (U, C, J) P(R_iu >= R_min) of each
    near_count: Ints  # (U, C) how many of the J there are
    period: Ints  # (I,) k_i, slots
    row: Ints  # (I,) first row of the device in the tables of ages
    age: Floats  # (rows, K+2) [row_i + a mod k_i, l]: age sum at the end of slot a + l, if collected in slot a
    gap: Floats  # (rows, K+2) the sum of these ages over the slots a + 1 to a + l - 1
    target: Ints  # (C, 5) cell that each move leads to
    home: Ints  # (U, C) grid steps to the CDS
    step_home: Ints  # (U, C) the move towards it
    cds: Ints  # (U,) cell
    budget: Ints  # (U,) grid steps


def make_chart(scenario: Scenario, layout: Layout) -> Chart:
    """Return the chart of a layout."""
    probability = cell_coverage(scenario, layout)  # (U, C, I)
    likely = probability >= _LEAST
    near_count = likely.sum(axis=2)  # (U, C)
    near = np.argsort(~likely, axis=2, kind="stable")[:, :, : max(int(near_count.max()), 1)]  # (U, C, J)
    periods, which = np.unique(layout.update_period, return_inverse=True)
    lengths = np.minimum(periods, scenario.slots + 1)  # phases that a mission can meet
    age, gap = np.zeros((2, int(lengths.sum()), scenario.slots + 2))
    first = np.cumsum(lengths) - lengths
    for period, row, length in zip(periods, first, lengths, strict=True):
        _write_ages(int(period), age[row : row + length], gap[row : row + length])
    flight = Flight(scenario)
    ways = flight.cds[:, None] - grid_cells(scenario)  # (U, C, 2)
    return Chart(
        near=np.ascontiguousarray(near),
        probability=np.take_along_axis(probability, near, axis=2),
        near_count=near_count,
        period=layout.update_period.astype(np.int64),
        row=first[which],
        age=age,
        gap=gap,
        target=neighbours(scenario)[0],
        home=np.abs(ways).sum(axis=-1),
        step_home=first_step(ways),
        cds=flight.cds @ np.array([scenario.rows, 1]),
        budget=flight.budget,
    )


@compiled_fast
def _write_ages(period: int, age: Floats, gap: Floats) -> None:
    """Fill the rows of one update period, by the recursion of the age ledger."""
    for phase in range(len(age)):
        waiting, total = 0.0, 0.0
        for slots in range(1, age.shape[1]):
            gap[phase, slots] = total
            waiting += (phase + slots) % period == 0
            age[phase, slots] = age[phase, slots - 1] + waiting
            total += age[phase, slots]


@compiled_fast
def score(chart: Chart, pull: Floats, serves: Bools, first_draw: int, ages: Floats) -> None:
    """Play missions of the rule.

    Args:
        chart: the layout.
        pull: of each device on a UAV in each cell, (U, C, I).
        serves: where it is not 0 in all cells, (U, I).
        first_draw: number of the first mission's fading.
        ages: the mean age sum over the slots of each mission, in slots, (missions,); written.
    """
    near, probability, near_count, period, row, age, gap, target, home, step_home, cds, budget = chart
    uavs, devices, slots = len(cds), len(row), age.shape[1] - 2
    own, own_count = _listed(serves)
    own_pull = _listed_pull(pull, own, own_count)
    cells, flown, current = np.empty(uavs, np.int64), np.empty(uavs, np.int64), np.empty(devices)
    seen, seen_row = np.empty((uavs, devices), np.int64), np.empty((uavs, devices), np.int64)
    last, last_row = np.empty(devices, np.int64), np.empty(devices, np.int64)
    for mission in range(len(ages)):
        for u in range(uavs):
            cells[u], flown[u] = cds[u], 0
            for i in range(devices):
                seen[u, i], seen_row[u, i], last[i], last_row[i] = 0, row[i], 0, row[i]
        total = 0.0
        for slot in range(1, slots + 1):
            for u in range(uavs):
                cell = cells[u]
                for j in range(near_count[u, cell]):
                    i = near[u, cell, j]
                    if _uniform(first_draw + mission, (slot * uavs + u) * devices + i) < probability[u, cell, j]:
                        here = row[i] + slot % period[i]
                        seen[u, i], seen_row[u, i] = slot, here
                        total += gap[last_row[i], slot - last[i]] + _first_update(last[i], slot)
                        last[i], last_row[i] = slot, here
            for u in range(uavs):
                _estimate(own[u, : own_count[u]], seen[u], seen_row[u], slot, age, current)
                move = _choose(
                    own_count[u], current, own_pull[u], target[cells[u]], home[u], slots - slot - 1,
                    budget[u] - flown[u], step_home[u, cells[u]],
                )  # fmt: skip
                there = target[cells[u], move]
                flown[u] += there != cells[u]
                cells[u] = there
        for i in range(devices):
            total += gap[last_row[i], slots + 1 - last[i]] + _first_update(last[i], slots + 1)
        ages[mission] = total / slots


@compiled_fast
def _listed(serves: Bools) -> tuple[Ints, Ints]:
    """Return the devices of each UAV, (U, I), of which the first ``count`` (U,) are filled in."""
    own, count = np.zeros(serves.shape, np.int64), np.zeros(len(serves), np.int64)
    for u in range(len(serves)):
        for i in range(serves.shape[1]):
            if serves[u, i]:
                own[u, count[u]] = i
                count[u] += 1
    return own, count


@compiled_fast
def _listed_pull(pull: Floats, own: Ints, count: Ints) -> Floats:
    """Return the pull of the devices of each UAV, side by side, (U, C, I)."""
    listed = np.zeros(pull.shape)
    for u in range(len(own)):
        for cell in range(pull.shape[1]):
            for j in range(count[u]):
                listed[u, cell, j] = pull[u, cell, own[u, j]]
    return listed


@compiled_fast
def _uniform(draw: int, index: int) -> float:
    """Return a number in [0, 1), a function of its arguments (SplitMix64)."""
    bits = (np.uint64(draw) << np.uint64(40)) * _SPREAD + _GOLDEN * np.uint64(index + 1)
    bits = (bits ^ (bits >> _RIGHT_30)) * _MIX_1
    bits = (bits ^ (bits >> _RIGHT_27)) * _MIX_2
    bits = bits ^ (bits >> _RIGHT_31)
    return np.int64(bits >> _RIGHT_11) * 2.0**-53


@compiled_fast
def _first_update(last: int, slot: int) -> float:
    """Return the ages before ``slot`` of the update that a device holds before slot 1, if it was never collected."""
    return 0.5 * (slot - 1) * slot if last == 0 else 0.0


@compiled_fast
def _estimate(own: Ints, seen: Ints, seen_row: Ints, slot: int, age: Floats, current: Floats) -> None:
    """Write the ages that a UAV expects of its devices at the end of ``slot``."""
    for j in range(len(own)):
        i = own[j]
        current[j] = age[seen_row[i], slot - seen[i]] + (slot if seen[i] == 0 else 0)


@compiled_fast
def _choose(
    count: int, current: Floats, pull: Floats, target: Ints, home: Ints, time_left: int, steps_left: int, otherwise: int
) -> int:
    """Return the allowed move with the largest value, the first of equals; ``otherwise`` if none is allowed."""
    best, chosen = -1.0, otherwise
    for move in range(5):
        there = target[move]
        moved = there != target[0]
        if (move > 0 and not moved) or home[there] > time_left or home[there] + moved > steps_left:
            continue
        value = 0.0
        for j in range(count):
            value += current[j] * pull[there, j]
        if value > best:
            best, chosen = value, move
    return chosen
