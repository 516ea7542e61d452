"""``local-greedy`` against its formula by loops, and every policy against what it says to know."""

import copy
from typing import Any

import numpy as np
import pytest
from scipy import stats

from uavaou import Scenario, World
from uavaou.planners import PLANNERS, make_planner
from uavaou.world.entities import make_views
from uavaou.world.knowledge import knowledge
from uavaou.world.pull import estimated_age, steps_to

QUICK = Scenario.load("quickstart").replace(slots=20)
STEPS = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)]


def test_a_uav_alone_estimates_the_true_ages() -> None:
    world = World(QUICK.replace(uavs=1, altitudes_m=[80], cds_m=[[0, 0]]), 3)
    rng = np.random.default_rng(0)
    while not world.done:
        world.step(rng.integers(0, 5, size=(3, 1)))
        last = world.last_collection_by[:, 0]  # (N, I)
        estimate = estimated_age(world.slot - 1, last, world.update_period)
        np.testing.assert_array_equal(estimate, world.ages.age_slots)


def test_steps_to_the_nearest_good_cell() -> None:
    good = np.random.default_rng(1).random((2, 5, 4, 3)) < 0.15  # (L, X, Y, I)
    good[0, ..., 0] = False
    steps = steps_to(good)
    for layout, x, y, i in np.ndindex(good.shape):
        cells = np.argwhere(good[layout, :, :, i])  # (n, 2)
        expected = np.abs(cells - [x, y]).sum(axis=1).min() if len(cells) else np.inf
        assert steps[layout, x, y, i] == expected


def coverage(scenario: Scenario, layout: Any, u: int, i: int) -> np.ndarray:
    """P(R >= R_min) in every cell by SciPy's distribution, (X, Y)."""
    x, y = np.meshgrid(np.arange(scenario.columns) * 100, np.arange(scenario.rows) * 100, indexing="ij")
    squared = (x - layout.positions[i, 0]) ** 2 + (y - layout.positions[i, 1]) ** 2 + scenario.altitudes_m[u] ** 2
    snr = layout.transmit_power[i] * scenario.reference_gain / squared / scenario.noise_power_w
    needed = (2 ** (scenario.rate_min_bit_s / layout.bandwidth[i]) - 1) / snr
    return np.asarray(stats.ncx2.sf(22 * needed, 2, 20))


def test_every_move_has_the_largest_pull() -> None:
    world, planner = World(QUICK, 2, 7), make_planner("local-greedy")
    planner.reset(world, 7)
    layout, reached = world.layout(), {}
    for u, i in np.ndindex(QUICK.uavs, QUICK.devices):
        found = coverage(QUICK, layout, u, i)
        reached[u, i] = np.argwhere(found >= 0.5 * found.max())  # (n, 2)
    away = np.abs(layout.positions[:, None] - np.array(QUICK.cds_m)).sum(axis=-1)  # (I, U)
    distinct = 0
    while not world.done:
        moves, _ = planner.act(world)
        for n, u in np.ndindex(moves.shape):
            pulls = []
            for move, step in enumerate(STEPS):
                pull = 0.0
                for i, period in enumerate(layout.update_period):
                    last = world.last_collection_by[n, u, i]
                    born = [k for k in range(0, world.slot + 1, period) if k > last or k == last == 0]
                    age = sum(world.slot - k + (k > 0) for k in born)
                    if not world.in_range[n, u, i] and away[i].argmin() == u:
                        steps = np.abs(reached[u, i] - world.cells[n, u] - step).sum(axis=1).min()
                        pull += age * np.exp(-float(steps))
                pulls.append(pull if world.allowed_moves[n, u, move] else -1.0)
            assert pulls[moves[n, u]] == pytest.approx(max(pulls), rel=1e-12)
            distinct += max(pulls) > min(pulls) + 1e-9
        world.step(moves)
    assert distinct > 50


def blind(world: World, uav: int, knows: str) -> World:
    """The world with everything drawn anew that a UAV with this knowledge cannot read."""
    scenario, rng, seen = world.scenario, np.random.default_rng(world.slot), copy.copy(world)
    own = np.arange(scenario.uavs) == uav  # (U,)
    flown = own & (knows != "nothing")  # a plan flies by the clock and by the own position alone

    def drawn(values: np.ndarray, most: Any, kept: np.ndarray) -> np.ndarray:
        """Values (N, U, ...) below ``most``, apart from those of the ``kept`` UAVs (U,)."""
        mask = kept.reshape(1, -1, *[1] * (values.ndim - 2))
        return np.where(mask, values, rng.integers(0, most, values.shape)).astype(values.dtype)

    seen.cells = drawn(world.cells, [scenario.columns, scenario.rows], own)
    seen.positions = seen.cells * scenario.grid_step_m
    seen.flown, seen.last_collection_by = (
        drawn(part, world.slot, flown) for part in (world.flown, world.last_collection_by)
    )
    seen.in_range, seen.allowed_moves = (drawn(part, 2, flown) for part in (world.in_range, world.allowed_moves))
    nobody = np.zeros(scenario.devices, dtype=bool)
    seen.last_collection = drawn(world.last_collection, world.slot, nobody)
    seen.ages, seen.channel = copy.copy(world.ages), copy.copy(world.channel)
    seen.ages.pending, seen.ages.age_slots = (
        drawn(part, world.slot, nobody) for part in (world.pending, world.ages.age_slots)
    )
    seen.channel.keys = world.channel.keys + np.uint64(1)
    seen.stepped, seen._rngs = None, []
    return seen


@pytest.mark.parametrize("name", PLANNERS)
def test_a_planner_reads_no_more_than_it_says(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.planners.anneal.PROPOSALS_A_SLOT", 20)
    monkeypatch.setattr("uavaou.planners.tuned.PROPOSALS", 20)
    scenario = QUICK.replace(fading="none" if name == "exact" else "rician")
    if name == "exact":
        scenario = Scenario.load("tiny")
    world, planner = World(scenario, 2, 3), make_planner(name)
    planner.reset(world, 3)
    knows, differs = knowledge(planner), 0
    while not world.done:
        told = "local" if knows == "everything" else knows
        blinded = [copy.deepcopy(planner).act(blind(world, u, told))[0][:, u] for u in range(scenario.uavs)]
        moves, _ = planner.act(world)
        differs += bool((moves != np.stack(blinded, axis=1)).any())
        world.step(moves)
    assert (differs > 0) == (knows == "everything")


@pytest.mark.parametrize(
    ("rows", "observation"), [("flat", "location"), ("flat", "local"), ("entities", "local"), ("entities", "part")]
)
def test_a_local_observation_holds_no_more_than_its_name_says(rows: Any, observation: Any) -> None:
    world = World(QUICK, 2, 3)
    views, rng = make_views(QUICK, observation, "select", rows), np.random.default_rng(0)
    while not world.done:
        seen = views.local(world)
        for u in range(QUICK.uavs):
            np.testing.assert_array_equal(views.local(blind(world, u, "local"))[:, u], seen[:, u])
        world.step(rng.integers(0, 5, size=(2, QUICK.uavs)))
