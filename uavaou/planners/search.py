"""The search that annealing runs, compiled: routes flown blindly, their exact expected age, and changes to them.

Fading is independent from slot to slot, so with the routes fixed each collection succeeds independently of all
before it. With f_i[t] the probability that no UAV has device i in range in slot t, the expected pending count m
and age sum S (in slots) after slot t obey the age ledger's own recursion,

    m_i[t] = f_i[t] (m_i[t-1] + g_i[t]),    S_i[t] = f_i[t] (S_i[t-1] + m_i[t-1] + g_i[t]),

g being 1 where an update is generated. The age still to come after slot t is linear in (m, S), with slopes that
obey a recursion backwards. Kept for every slot, both make the age of changed routes cost only the slots changed.

All compiled functions stand in this one file: Numba's store of machine code notices a change in the file of the
function called, not in those of the functions that it calls.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

from uavaou.scenario import Layout, Scenario
from uavaou.world.coverage import coverage_probability

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Rng = Any  # np.random.Generator, the whole numbers of which are plain ones once compiled

_LONGEST_DETOUR = 16  # slots that one detour may rewrite
_LONGEST_COPY = 60  # slots copied at once; about two rounds of a tour
_FARTHEST_SHIFT = 4  # slots
_NOTHING = (0, 0)

_SETTLED = 1e-13  # relative change of a device's state below which later slots are left as they are


F = TypeVar("F", bound=Callable[..., object])

# What lets LLVM sum in vectors; infinities and NaNs keep their meaning.
_FAST = {"reassoc", "contract", "nsz", "arcp"}


def compiled(function: F) -> F:
    """Compile a function of arrays and numbers on its first call; the machine code is kept on disk."""
    return cast(F, numba.njit(cache=True, fastmath=_FAST)(function))


class Expectation(NamedTuple):
    """Routes of a fleet and their expected ages; row t of each array is slot t, row 0 the moment before slot 1.

    A NamedTuple, because compiled functions take one as it is. Ages are in slots.
    """

    miss: Floats  # (U, C, I) 1 - P(R_iu >= R_min) with UAV u in a cell
    generated: Floats  # (K+1, I) 1 where t mod k_i = 0
    routes: Ints  # (U, K+1) cell = column * rows + row
    missed: Floats  # (K+1, I) f_i[t]
    pending: Floats  # (K+1, I) m_i[t]
    age: Floats  # (K+1, I) S_i[t]
    spent: Floats  # (K+1,) sum over devices and over slots up to t of S_i
    pending_slope: Floats  # (K+1, I) age to come after slot t for each pending update
    age_slope: Floats  # (K+1, I) age to come after slot t for each slot of age
    constant: Floats  # (K+1,) age to come after slot t from updates generated later


def expect(scenario: Scenario, layout: Layout, routes: Ints) -> Expectation:
    """The expected ages of ``routes`` (K, U, 2), cells by column and row, slots 1 to K."""
    slots, devices = scenario.slots, scenario.devices
    probability = coverage_probability(scenario, layout).reshape(scenario.uavs, -1, devices)  # (U, C, I)
    generated = np.arange(slots + 1)[:, None] % layout.update_period == 0  # (K+1, I)
    cells = routes[..., 0] * scenario.rows + routes[..., 1]  # (K, U)
    by_slot, by_device = np.zeros(slots + 1), np.zeros((slots + 1, devices))
    expectation = Expectation(
        miss=1.0 - probability,
        generated=generated.astype(np.float64),
        routes=np.ascontiguousarray(np.concatenate([cells[:1], cells]).T),
        missed=np.ones((slots + 1, devices)),
        pending=np.ones((slots + 1, devices)),
        age=by_device.copy(),
        spent=by_slot.copy(),
        pending_slope=by_device.copy(),
        age_slope=by_device.copy(),
        constant=by_slot.copy(),
    )
    refresh(expectation)
    return expectation


def total_age(expectation: Expectation) -> float:
    """sum over slots and devices of E[sum_n A_i^n], in slots squared: K times the mean AoU, over tau."""
    return float(expectation.spent[-1])


def mean_aou_s(scenario: Scenario, layout: Layout, routes: Ints) -> float:
    """The expected mean AoU in s of ``routes`` (K, U, 2) flown blindly."""
    return scenario.slot_length_s * total_age(expect(scenario, layout, routes)) / scenario.slots


@compiled
def refresh(e: Expectation) -> None:
    """Recompute everything from the routes."""
    last = len(e.spent) - 1
    for t in range(1, last + 1):
        _meet(e, t)
        _forward(e, t)
    for t in range(last, 0, -1):
        _backward(e, t)


@compiled
def trial_age(e: Expectation, uav: int, first: int, end: int, trial: Ints, pending: Floats, age: Floats) -> float:
    """The total age if ``uav`` were in cells ``trial[t]`` (K+1,) in slots first <= t < end.

    ``pending`` and ``age`` (I,) are room to work in; afterwards they hold the state after slot end - 1.
    """
    devices = len(pending)
    total = float(e.spent[first - 1])
    for i in range(devices):
        pending[i] = e.pending[first - 1, i]
        age[i] = e.age[first - 1, i]
    for t in range(first, end):
        if trial[t] == e.routes[uav, t]:
            total += _advance(e.missed[t], e.generated[t], pending, age)
        else:
            total += _advance_changed(e, uav, t, trial[t], pending, age)
    for i in range(devices):
        total += e.pending_slope[end - 1, i] * pending[i] + e.age_slope[end - 1, i] * age[i]
    return total + float(e.constant[end - 1])


@compiled
def _advance(missed: Floats, generated: Floats, pending: Floats, age: Floats) -> float:
    total = 0.0
    for i in range(len(pending)):
        waiting = pending[i] + generated[i]
        left = missed[i] * (age[i] + waiting)
        pending[i] = missed[i] * waiting
        age[i] = left
        total += left
    return total


@compiled
def _advance_changed(e: Expectation, uav: int, t: int, cell: int, pending: Floats, age: Floats) -> float:
    uavs = len(e.routes)
    total = 0.0
    own = e.miss[uav, cell]
    if uavs == 3:  # the paper's fleet, in one pass
        one, two = (uav + 1) % 3, (uav + 2) % 3
        other, another = e.miss[one, e.routes[one, t]], e.miss[two, e.routes[two, t]]
        for i in range(len(pending)):
            missed = own[i] * other[i] * another[i]
            waiting = pending[i] + e.generated[t, i]
            left = missed * (age[i] + waiting)
            pending[i] = missed * waiting
            age[i] = left
            total += left
        return total
    for i in range(len(pending)):
        missed = own[i]
        for v in range(uavs):
            if v != uav:
                missed *= e.miss[v, e.routes[v, t], i]
        waiting = pending[i] + e.generated[t, i]
        left = missed * (age[i] + waiting)
        pending[i] = missed * waiting
        age[i] = left
        total += left
    return total


@compiled
def change(e: Expectation, uav: int, first: int, end: int, trial: Ints) -> None:
    """Let ``uav`` be in cells ``trial[t]`` (K+1,) in slots first <= t < end, and bring everything up to date."""
    last = len(e.spent) - 1
    for t in range(first, end):
        if trial[t] != e.routes[uav, t]:
            e.routes[uav, t] = trial[t]
            _meet(e, t)
    t = first
    while t <= last:
        before = e.spent[t]
        settled = _forward(e, t)
        t += 1
        if settled and t >= end:
            e.spent[t:] += e.spent[t - 1] - before
            break
    t = end - 1
    while t >= 1:
        before = e.constant[t - 1]
        settled = _backward(e, t)
        t -= 1
        if settled and t < first:
            e.constant[:t] += e.constant[t] - before
            break


@compiled
def _meet(e: Expectation, t: int) -> None:
    for i in range(e.missed.shape[1]):
        missed = 1.0
        for u in range(len(e.routes)):
            missed *= e.miss[u, e.routes[u, t], i]
        e.missed[t, i] = missed


@compiled
def _forward(e: Expectation, t: int) -> bool:
    """Slot t of the ledger; whether it ended as it did before."""
    total = 0.0
    settled = True
    for i in range(e.missed.shape[1]):
        waiting = e.pending[t - 1, i] + e.generated[t, i]
        age = e.missed[t, i] * (e.age[t - 1, i] + waiting)
        pending = e.missed[t, i] * waiting
        settled &= abs(age - e.age[t, i]) + abs(pending - e.pending[t, i]) <= _SETTLED * age
        e.age[t, i] = age
        e.pending[t, i] = pending
        total += age
    e.spent[t] = e.spent[t - 1] + total
    return settled


@compiled
def _backward(e: Expectation, t: int) -> bool:
    """The slopes before slot t from those after it; whether they are as before."""
    total = 0.0
    settled = True
    for i in range(e.missed.shape[1]):
        age = e.missed[t, i] * (1.0 + e.age_slope[t, i])
        pending = age + e.missed[t, i] * e.pending_slope[t, i]
        settled &= abs(age - e.age_slope[t - 1, i]) + abs(pending - e.pending_slope[t - 1, i]) <= _SETTLED * pending
        e.age_slope[t - 1, i] = age
        e.pending_slope[t - 1, i] = pending
        total += e.generated[t, i] * pending
    e.constant[t - 1] = e.constant[t] + total
    return settled


# -- proposals: changes to one UAV's route ---------------------------------------------------------------
#
# Routes hold cells as column * rows + row, by slot; slot 1 and slot K are the CDS and never change. Each proposal
# writes ``trial`` in slots first <= t < end and returns (first, end), equal where it found nothing; every step stays
# a grid step.


@compiled
def steps(one: int, other: int, rows: int) -> int:
    """Grid steps between two cells."""
    return abs(one // rows - other // rows) + abs(one % rows - other % rows)


@compiled
def _walk(trial: Ints, slot: int, here: int, there: int, rows: int, rng: Rng) -> int:
    """Write a shortest way from ``here`` (not written) to ``there``, from ``slot`` on; the slot after its end."""
    x, y, to_x, to_y = here // rows, here % rows, there // rows, there % rows
    lean = rng.integers(0, 3)  # along x first, along y first, or mixed
    while x != to_x or y != to_y:
        along_x = x != to_x and (y == to_y or lean == 0 or (lean == 2 and rng.random() < 0.5))
        if along_x:
            x += 1 if to_x > x else -1
        else:
            y += 1 if to_y > y else -1
        trial[slot] = x * rows + y
        slot += 1
    return slot


@compiled
def _fill(trial: Ints, slot: int, here: int, there: int, moves: int, columns: int, rows: int, rng: Rng) -> bool:
    """Write a random way of exactly ``moves`` moves, stays included, from ``here`` over some cell to ``there``.

    The cells strictly between go to ``slot`` and the moves - 1 slots from there; ``there`` is written last.
    """
    slack = moves - steps(here, there, rows)
    if slack < 0:
        return False
    via = here
    for _ in range(8):  # a cell that leaves enough moves; nearby ones, so that most draws do
        reach = slack // 2 + 1
        x = here // rows + rng.integers(-reach, reach + 1)
        y = here % rows + rng.integers(-reach, reach + 1)
        if rng.random() < 0.5:
            x += there // rows - here // rows
            y += there % rows - here % rows
        if 0 <= x < columns and 0 <= y < rows:
            cell = x * rows + y
            if steps(here, cell, rows) + steps(cell, there, rows) <= moves:
                via = cell
                break
    wait = moves - steps(here, via, rows) - steps(via, there, rows)
    early = wait if rng.random() < 0.5 else rng.integers(0, wait + 1)  # at the cell; the rest at either end
    late = wait - early
    if rng.random() < 0.5:
        for _ in range(late):
            trial[slot] = here
            slot += 1
        late = 0
    slot = _walk(trial, slot, here, via, rows, rng)
    for _ in range(early):
        trial[slot] = via
        slot += 1
    slot = _walk(trial, slot, via, there, rows, rng)
    for _ in range(late):
        trial[slot] = there
        slot += 1
    return True


@compiled
def detour(route: Ints, trial: Ints, low: int, high: int, columns: int, rows: int, rng: Rng) -> tuple[int, int]:
    """Another way over the same slots, somewhere in low <= t < high."""
    length = rng.integers(1, min(_LONGEST_DETOUR, high - low) + 1)
    first = rng.integers(low, high - length + 1)
    end = first + length
    if not _fill(trial, first, route[first - 1], route[end], length + 1, columns, rows, rng):
        return _NOTHING
    return first, end


@compiled
def shift(route: Ints, trial: Ints, low: int, high: int, columns: int, rows: int, rng: Rng) -> tuple[int, int]:
    """A detour that takes d slots more, one later that takes d less, and all between d slots later (d < 0: earlier)."""
    later = rng.integers(1, _FARTHEST_SHIFT + 1) * (1 if rng.random() < 0.5 else -1)
    one, two = rng.integers(0, 9), rng.integers(0, 9)  # slots rewritten at both ends, before
    room = high - low - one - two
    if room < 1 or one + later < 0 or two - later < 0:
        return _NOTHING
    between = min(int(room), int(np.exp(rng.random() * np.log(room + 1.0))))
    first = rng.integers(low, high - one - two - between + 1)
    middle, after = first + one, first + one + between
    end = after + two
    if not _fill(trial, first, route[first - 1], route[middle], one + later + 1, columns, rows, rng):
        return _NOTHING
    for t in range(middle, after):
        trial[t + later] = route[t]
    if not _fill(trial, after + later, route[after - 1], route[end], two - later + 1, columns, rows, rng):
        return _NOTHING
    return first, end


@compiled
def reverse(route: Ints, trial: Ints, low: int, high: int, rows: int, rng: Rng) -> tuple[int, int]:
    """A stretch flown the other way round, as 2-opt does."""
    first = rng.integers(low, high)
    found = 0
    for end in range(first + 3, min(first + _LONGEST_COPY, high) + 1):
        if steps(route[first - 1], route[end - 1], rows) <= 1 and steps(route[first], route[end], rows) <= 1:
            found = end
            if rng.random() < 0.5:
                break
    if found == 0:
        return _NOTHING
    for t in range(first, found):
        trial[t] = route[first + found - 1 - t]
    return first, found


@compiled
def copy(
    source: Ints, route: Ints, trial: Ints, low: int, high: int, columns: int, rows: int, rng: Rng
) -> tuple[int, int]:
    """What some UAV flies at another time, flown here too: good rounds spread over the mission."""
    slots = len(route) - 1
    length = rng.integers(3, min(_LONGEST_COPY, slots) + 1)
    start = rng.integers(1, slots - length + 2)
    first = rng.integers(low, high)
    join = steps(route[first - 1], source[start], rows)
    leave = first - 1 + join + length - 1  # the slot in which the copy ends
    for end in range(leave + 1, high + 1):
        missing = end - leave
        if steps(source[start + length - 1], route[end], rows) <= missing:
            _fill(trial, first, route[first - 1], source[start], join, columns, rows, rng)
            for k in range(length):
                trial[first - 1 + join + k] = source[start + k]
            _fill(trial, leave + 1, source[start + length - 1], route[end], missing, columns, rows, rng)
            return first, end
    return _NOTHING


# -- annealing -------------------------------------------------------------------------------------------


@compiled
def anneal(
    e: Expectation,
    grid: tuple[int, int],
    budget: Ints,
    flown: Ints,
    between: tuple[int, int],
    temperatures: tuple[float, float],
    proposals: int,
    best: Ints,
    best_age: float,
    rng: Rng,
) -> float:
    """Metropolis steps under geometric cooling; the best total age met.

    Args:
        e: routes and expectation; changed in place.
        grid: columns and rows.
        budget: grid steps that each UAV affords, (U,).
        flown: grid steps of each route, (U,); changed in place.
        between: low and high; slots low <= t < high may change.
        temperatures: first and last, in slots of total age.
        proposals: number of them.
        best: the best routes, (U, K+1); changed in place.
        best_age: their total age.
        rng: a generator.
    """
    uavs, slots = len(e.routes), len(e.spent) - 1
    trial = np.empty(2 * slots + 64, dtype=np.int64)  # room beyond slot K for proposals that turn out too long
    pending, age = np.empty(e.age.shape[1]), np.empty(e.age.shape[1])  # (I,)
    now, temperature = e.spent[slots], temperatures[0]
    cooling = (temperatures[1] / temperatures[0]) ** (1.0 / proposals)
    for _ in range(proposals):
        temperature *= cooling
        uav = rng.integers(0, uavs)
        first, end = _propose(e.routes, uav, trial, between, grid, rng)
        route = e.routes[uav]
        while first < end and trial[first] == route[first]:
            first += 1
        while first < end and trial[end - 1] == route[end - 1]:
            end -= 1
        if first == end:
            continue
        more = _extra_steps(route, trial, first, end)
        if flown[uav] + more > budget[uav]:
            continue
        changed = trial_age(e, uav, first, end, trial, pending, age)
        if changed <= now or rng.random() < np.exp((now - changed) / temperature):
            change(e, uav, first, end, trial)
            flown[uav] += more
            now = e.spent[slots]
            if now < best_age:
                best_age = now
                best[:] = e.routes
    return best_age


@compiled
def _propose(
    routes: Ints, uav: int, trial: Ints, between: tuple[int, int], grid: tuple[int, int], rng: Rng
) -> tuple[int, int]:
    low, high = between
    columns, rows = grid
    kind = rng.random()
    if kind < 0.55:
        return detour(routes[uav], trial, low, high, columns, rows, rng)
    if kind < 0.85:
        return shift(routes[uav], trial, low, high, columns, rows, rng)
    if kind < 0.9:
        return reverse(routes[uav], trial, low, high, rows, rng)
    other = rng.integers(0, len(routes))
    return copy(routes[other], routes[uav], trial, low, high, columns, rows, rng)


@compiled
def _extra_steps(route: Ints, trial: Ints, first: int, end: int) -> int:
    """Grid steps that the changed route has more than the old one."""
    more = 0
    for t in range(first, end + 1):
        before = trial[t - 1] if t > first else route[t - 1]
        there = trial[t] if t < end else route[t]
        more += int(there != before) - int(route[t] != route[t - 1])
    return more


# -- rolling horizon -------------------------------------------------------------------------------------


@compiled
def observe(e: Expectation, slot: int, pending: Floats, age: Floats) -> None:
    """Replace the expected state after ``slot`` by the true one, (I,) each; later slots follow.

    ``spent`` then holds the age of later slots on top of an offset, which no comparison of routes sees.
    """
    e.pending[slot] = pending
    e.age[slot] = age
    last = len(e.spent) - 1
    for t in range(slot + 1, last + 1):
        before = e.spent[t]
        if _forward(e, t):
            e.spent[t + 1 :] += e.spent[t] - before
            break


@compiled
def replan(
    e: Expectation,
    grid: tuple[int, int],
    budget: Ints,
    between: tuple[int, int],
    temperatures: tuple[float, float],
    proposals: int,
    rng: Rng,
) -> None:
    """Anneal slots low <= t < high and leave the best routes met; arguments as :func:`anneal` takes them."""
    uavs, last = len(e.routes), len(e.spent) - 1
    flown = np.zeros(uavs, dtype=np.int64)
    for u in range(uavs):
        for t in range(2, last + 1):
            flown[u] += int(e.routes[u, t] != e.routes[u, t - 1])
    best = e.routes.copy()
    anneal(e, grid, budget, flown, between, temperatures, proposals, best, e.spent[last], rng)
    low, high = between
    for u in range(uavs):
        change(e, u, low, high, best[u])
