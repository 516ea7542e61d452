"""The compiled kernels of simulated annealing: the expected age of fixed routes, and changes to the routes.

They copy arrays in loops: for ``a[:] = b`` Numba also compiles the message of unequal shapes.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaou.arrays import Bools, Floats, Ints
from uavaou.planners.expected import ExpectedAge
from uavaou.world.compiled import compiled_fast, uninterrupted
from uavaou.world.flight import UNLIMITED

Rng = Any  # np.random.Generator; its whole numbers are plain ones once compiled
Pair = tuple[int, int]
NO_STATIONS: Bools = np.zeros(0, dtype=np.bool_)
Grid = tuple[int, int, NDArray[np.int32]]  # columns, rows, and where UAVs fly around zones, the moves between cells

_LONGEST_DETOUR = 16  # slots that one detour may rewrite
_LONGEST_COPY = 60  # slots copied at once; about two rounds of a tour
_FARTHEST_SHIFT = 4  # slots
_NOTHING = (0, 0)  # slots changed by a proposal that found no change
_SETTLED = 1e-13  # relative change of a device's state below which the recursion stops


@compiled_fast
def recompute(e: ExpectedAge) -> None:
    """Compute everything from the routes."""
    for t in range(1, len(e.cumulative)):
        _update_miss(e, t)
        _forward(e, t)
    for t in range(len(e.cumulative) - 1, 0, -1):
        _backward(e, t)


@compiled_fast
def trial_age(e: ExpectedAge, uav: int, first: int, end: int, trial: Ints, work: Floats) -> float:
    """Return the total age with ``uav`` in cells ``trial[t]`` (K+1,) in slots first <= t < end; ``work`` is (3, I)."""
    pending, age, missed = work[0], work[1], work[2]
    for i in range(len(age)):
        pending[i] = e.pending[first - 1, i]
        age[i] = e.age[first - 1, i]
    total = float(e.cumulative[first - 1])
    for t in range(first, end):
        if trial[t] == e.routes[uav, t]:
            total += _advance(e.fleet_miss[t], e.generated[t], pending, age)
        else:
            _changed_miss(e, uav, t, trial[t], missed)
            total += _advance(missed, e.generated[t], pending, age)
    for i in range(len(age)):
        total += e.to_go_per_pending[end - 1, i] * pending[i] + e.to_go_per_age[end - 1, i] * age[i]
    return total + float(e.to_go_constant[end - 1])


@compiled_fast
def _advance(missed: Floats, generated: Floats, pending: Floats, age: Floats) -> float:
    total = 0.0
    for i in range(len(pending)):
        waiting = pending[i] + generated[i]
        age[i] = missed[i] * (age[i] + waiting)
        pending[i] = missed[i] * waiting
        total += age[i]
    return total


@compiled_fast
def _changed_miss(e: ExpectedAge, uav: int, t: int, cell: int, missed: Floats) -> None:
    """Write f_i[t] (I,) with ``uav`` in another cell."""
    own = e.miss[uav, cell]
    for i in range(len(missed)):
        missed[i] = own[i]
    for v in range(len(e.routes)):
        if v != uav:
            other = e.miss[v, e.routes[v, t]]
            for i in range(len(missed)):  # one UAV after the other: LLVM turns this loop into vectors
                missed[i] *= other[i]


@compiled_fast
def change(e: ExpectedAge, uav: int, first: int, end: int, trial: Ints) -> None:
    """Put ``uav`` into cells ``trial[t]`` (K+1,) in slots first <= t < end, and update the expected ages."""
    for t in range(first, end):
        if trial[t] != e.routes[uav, t]:
            e.routes[uav, t] = trial[t]
            _update_miss(e, t)
    follow(e, first, end)
    for t in range(end - 1, 0, -1):
        before = e.to_go_constant[t - 1]
        settled = _backward(e, t)
        if settled and t <= first:
            more = e.to_go_constant[t - 1] - before
            for s in range(t - 1):
                e.to_go_constant[s] += more
            break


@compiled_fast
def follow(e: ExpectedAge, first: int, end: int) -> None:
    """Recompute the slots from ``first`` on, at least up to ``end`` and until a slot ends as it did before."""
    for t in range(first, len(e.cumulative)):
        before = e.cumulative[t]
        settled = _forward(e, t)
        if settled and t + 1 >= end:
            more = e.cumulative[t] - before
            for s in range(t + 1, len(e.cumulative)):
                e.cumulative[s] += more
            break


@compiled_fast
def _update_miss(e: ExpectedAge, t: int) -> None:
    """Compute f_i[t] from the routes."""
    for i in range(e.fleet_miss.shape[1]):
        missed = 1.0
        for u in range(len(e.routes)):
            missed *= e.miss[u, e.routes[u, t], i]
        e.fleet_miss[t, i] = missed


@compiled_fast
def _forward(e: ExpectedAge, t: int) -> bool:
    """Compute slot t of the recursion from slot t - 1; return whether the result is as before."""
    total, settled = 0.0, True
    for i in range(e.fleet_miss.shape[1]):
        waiting = e.pending[t - 1, i] + e.generated[t, i]
        age = e.fleet_miss[t, i] * (e.age[t - 1, i] + waiting)
        pending = e.fleet_miss[t, i] * waiting
        settled &= abs(age - e.age[t, i]) + abs(pending - e.pending[t, i]) <= _SETTLED * age
        e.age[t, i] = age
        e.pending[t, i] = pending
        total += age
    e.cumulative[t] = e.cumulative[t - 1] + total
    return settled


@compiled_fast
def _backward(e: ExpectedAge, t: int) -> bool:
    """Compute the cost to go before slot t from that after it; return whether it is as before."""
    total, settled = 0.0, True
    for i in range(e.fleet_miss.shape[1]):
        age = e.fleet_miss[t, i] * (1.0 + e.to_go_per_age[t, i])
        pending = age + e.fleet_miss[t, i] * e.to_go_per_pending[t, i]
        change = abs(age - e.to_go_per_age[t - 1, i]) + abs(pending - e.to_go_per_pending[t - 1, i])
        settled &= change <= _SETTLED * pending
        e.to_go_per_age[t - 1, i] = age
        e.to_go_per_pending[t - 1, i] = pending
        total += e.generated[t, i] * pending
    e.to_go_constant[t - 1] = e.to_go_constant[t] + total
    return settled


# -- proposals: changes to one UAV's route ---------------------------------------------------------------
#
# The cells of slots 1 and K are the CDS and never change. A proposal writes ``trial`` in slots first <= t < end, keeps
# every step a grid step, and returns (first, end); the two are equal if it found no change.


@compiled_fast
def steps(one: int, other: int, grid: Grid) -> int:
    """Return the grid steps between two cells."""
    rows, ways = grid[1], grid[2]
    if len(ways) > 0:
        return int(ways[one, other])
    return abs(one // rows - other // rows) + abs(one % rows - other % rows)


@compiled_fast
def _walk(trial: Ints, slot: int, here: int, there: int, grid: Grid, rng: Rng) -> int:
    """Write a shortest path from ``here`` (not written) to ``there``, from ``slot`` on; return the slot after it."""
    lean = rng.integers(0, 3)  # along x first, along y first, or mixed
    while here != there:
        here = _nearer(here, there, lean, grid, rng)
        trial[slot] = here
        slot += 1
    return slot


@compiled_fast
def _nearer(here: int, there: int, lean: int, grid: Grid, rng: Rng) -> int:
    """Return the next cell of a shortest path."""
    columns, rows, ways = grid
    if len(ways) == 0:
        x, y = there // rows - here // rows, there % rows - here % rows
        if x != 0 and (y == 0 or lean == 0 or (lean == 2 and rng.random() < 0.5)):
            return here + (rows if x > 0 else -rows)
        return here + (1 if y > 0 else -1)
    chosen, found = here, 0
    for k in range(4):
        along_x, step = (k < 2) != (lean == 1), 1 - 2 * (k % 2)
        x, y = here // rows + step * along_x, here % rows + step * (not along_x)
        cell = x * rows + y
        inside = 0 <= x < columns and 0 <= y < rows
        if inside and ways[here, cell] == 1 and ways[cell, there] < ways[here, there]:
            found += 1
            if found == 1 or (lean == 2 and rng.random() * found < 1.0):
                chosen = cell
    return chosen


@compiled_fast
def _fill(trial: Ints, slot: int, here: int, there: int, moves: int, grid: Grid, rng: Rng) -> bool:
    """Write a random path of exactly ``moves`` moves (a stay is a move) from ``here`` to ``there``, from ``slot`` on.

    The cells between are moves - 1; ``there`` is the last cell written. Return False if ``moves`` are too few.
    """
    columns, rows = grid[0], grid[1]
    slack = moves - steps(here, there, grid)
    if slack < 0:
        return False
    via = here
    for _ in range(8):  # a cell on the way that leaves enough moves; most nearby cells do
        reach = slack // 2 + 1
        x = here // rows + rng.integers(-reach, reach + 1)
        y = here % rows + rng.integers(-reach, reach + 1)
        if rng.random() < 0.5:
            x += there // rows - here // rows
            y += there % rows - here % rows
        if 0 <= x < columns and 0 <= y < rows:
            cell = x * rows + y
            if steps(here, cell, grid) + steps(cell, there, grid) <= moves:
                via = cell
                break
    wait = moves - steps(here, via, grid) - steps(via, there, grid)
    early = wait if rng.random() < 0.5 else rng.integers(0, wait + 1)  # stays at that cell
    late = wait - early  # stays at either end
    if rng.random() < 0.5:
        trial[slot : slot + late] = here
        slot, late = slot + late, 0
    slot = _walk(trial, slot, here, via, grid, rng)
    trial[slot : slot + early] = via
    slot = _walk(trial, slot + early, via, there, grid, rng)
    trial[slot : slot + late] = there
    return True


@compiled_fast
def detour(route: Ints, trial: Ints, low: int, high: int, grid: Grid, rng: Rng) -> Pair:
    """Fly another path in some slots of low <= t < high."""
    length = rng.integers(1, min(_LONGEST_DETOUR, high - low) + 1)
    first = rng.integers(low, high - length + 1)
    end = first + length
    return (first, end) if _fill(trial, first, route[first - 1], route[end], length + 1, grid, rng) else _NOTHING


@compiled_fast
def shift(route: Ints, trial: Ints, low: int, high: int, grid: Grid, rng: Rng) -> Pair:
    """Lengthen one stretch by d slots, shorten a later one by d, and delay all between by d slots (or the reverse)."""
    later = rng.integers(1, _FARTHEST_SHIFT + 1) * (1 if rng.random() < 0.5 else -1)
    one, two = rng.integers(0, 9), rng.integers(0, 9)  # slots rewritten at both ends
    room = high - low - one - two
    if room < 1 or one + later < 0 or two - later < 0:
        return _NOTHING
    between = min(int(room), int(np.exp(rng.random() * np.log(room + 1.0))))
    first = rng.integers(low, high - one - two - between + 1)
    middle, after = first + one, first + one + between
    end = after + two
    if not _fill(trial, first, route[first - 1], route[middle], one + later + 1, grid, rng):
        return _NOTHING
    for t in range(middle, after):
        trial[t + later] = route[t]
    if not _fill(trial, after + later, route[after - 1], route[end], two - later + 1, grid, rng):
        return _NOTHING
    return first, end


@compiled_fast
def reverse(route: Ints, trial: Ints, low: int, high: int, grid: Grid, rng: Rng) -> Pair:
    """Fly a stretch in reverse, as 2-opt does."""
    found = first = rng.integers(low, high)
    for end in range(first + 3, min(first + _LONGEST_COPY, high) + 1):
        if steps(route[first - 1], route[end - 1], grid) <= 1 and steps(route[first], route[end], grid) <= 1:
            found = end
            if rng.random() < 0.5:
                break
    for t in range(first, found):
        trial[t] = route[first + found - 1 - t]
    return first, found


@compiled_fast
def copy(source: Ints, route: Ints, trial: Ints, low: int, high: int, grid: Grid, rng: Rng) -> Pair:
    """Repeat a stretch that some UAV flies at another time, so that good rounds spread over the mission."""
    slots = len(route) - 1
    length = rng.integers(3, min(_LONGEST_COPY, slots) + 1)
    start = rng.integers(1, slots - length + 2)
    first = rng.integers(low, high)
    join = steps(route[first - 1], source[start], grid)
    leave = first - 1 + join + length - 1  # the slot in which the copy ends
    for end in range(leave + 1, high + 1):
        missing = end - leave
        if steps(source[start + length - 1], route[end], grid) <= missing:
            _fill(trial, first, route[first - 1], source[start], join, grid, rng)
            for n in range(length):
                trial[first - 1 + join + n] = source[start + n]
            _fill(trial, leave + 1, source[start + length - 1], route[end], missing, grid, rng)
            return first, end
    return _NOTHING


@uninterrupted
@compiled_fast
def anneal(
    e: ExpectedAge,
    grid: tuple[int, int, NDArray[np.int32]],
    budget: Ints,
    flown: Ints,
    between: Pair,
    temperatures: tuple[float, float],
    proposals: int,
    best: Ints,
    best_age: float,
    rng: Rng,
    stations: Bools,
) -> float:
    """Run Metropolis steps under geometric cooling and return the best total age met.

    Args:
        e: routes and expected ages; changed in place.
        grid: columns, rows, and :func:`uavaou.world.flight.ways`, (T, C, C).
        budget: grid steps that each UAV may fly, (U,).
        flown: grid steps of each route, (U,); changed in place.
        between: low and high; slots low <= t < high may change.
        temperatures: the first and the last, in slots of total age.
        best, best_age: the best routes, (U, K+1), changed in place; their total age, slots squared.
        stations: cells in which a stay is a swap of batteries, (C,), or none: (0,); cell C is that of an absent UAV.
    """
    uavs, slots = len(e.routes), len(e.cumulative) - 1
    trial = np.empty(2 * slots + 64, dtype=np.int64)  # beyond slot K: space for paths that are too long
    work = np.empty((3, e.age.shape[1]))  # (3, I)
    now, temperature = e.cumulative[slots], temperatures[0]
    cooling = (temperatures[1] / temperatures[0]) ** (1.0 / proposals)
    for _ in range(proposals):
        temperature *= cooling
        uav = rng.integers(0, uavs)
        own = (grid[0], grid[1], grid[2][min(uav, len(grid[2]) - 1)])
        first, end = _propose(e.routes, uav, trial, between, own, rng)
        route = e.routes[uav]
        while first < end and trial[first] == route[first]:
            first += 1
        while first < end and trial[end - 1] == route[end - 1]:
            end -= 1
        if first == end:
            continue
        if len(stations) > 0 and not _keeps_swaps(route, trial, first, end, stations):
            continue
        more = _extra_steps(route, trial, first, end, own[2])
        if flown[uav] + more > budget[uav]:
            continue
        changed = trial_age(e, uav, first, end, trial, work)
        if changed <= now or rng.random() < np.exp((now - changed) / temperature):
            change(e, uav, first, end, trial)
            flown[uav] += more
            now = e.cumulative[slots]
            if now < best_age:
                best_age = now
                for u in range(uavs):
                    for t in range(slots + 1):
                        best[u, t] = e.routes[u, t]
    return best_age


@compiled_fast
def _propose(routes: Ints, uav: int, trial: Ints, between: Pair, grid: Grid, rng: Rng) -> Pair:
    (low, high), kind = between, rng.random()
    if kind < 0.55:
        return detour(routes[uav], trial, low, high, grid, rng)
    if kind < 0.85:
        return shift(routes[uav], trial, low, high, grid, rng)
    if kind < 0.9:
        return reverse(routes[uav], trial, low, high, grid, rng)
    other = rng.integers(0, len(routes))
    return copy(routes[other], routes[uav], trial, low, high, grid, rng)


@compiled_fast
def _keeps_swaps(route: Ints, trial: Ints, first: int, end: int, stations: Bools) -> bool:
    before, away = route[first - 1], len(stations)
    for t in range(first, end + 1):
        there = trial[t] if t < end else route[t]
        kept = t < end and there == route[t] and before == route[t - 1]
        if max(before, there, route[t]) >= away or (there == before and stations[there] and not kept):
            return False
        before = there
    return True


@compiled_fast
def _extra_steps(route: Ints, trial: Ints, first: int, end: int, ways: NDArray[np.int32]) -> int:
    """Return the grid steps that ``trial`` adds to the route; more than any budget where it crosses a zone."""
    more = 0
    for t in range(first, end + 1):
        before = trial[t - 1] if t > first else route[t - 1]
        there = trial[t] if t < end else route[t]
        more += int(there != before) - int(route[t] != route[t - 1])
        if len(ways) > 0 and ways[before, there] > 1:
            return 2 * UNLIMITED
    return more
