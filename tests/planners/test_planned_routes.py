"""Planners that lay routes: flyable plans, exact expected ages, the optimum by brute force, and the bound below all."""

import itertools
import json
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.planners.test_bound import most_prices
from uavaou import InputError, Scenario, World, evaluate
from uavaou.planners import PLAN_AHEAD, PLANNERS, make_planner
from uavaou.planners.anneal import Anneal, best_first_routes
from uavaou.planners.bound import LagrangianRelaxation, lower_bound
from uavaou.planners.decomposition import LagrangianDecomposition
from uavaou.planners.exact import Exact, Program, gap_ages
from uavaou.planners.plan import PlanningStatus, RoutePlan, broken_rule, expected_age, expected_mean_aou
from uavaou.planners.rolling import Rolling
from uavaou.planners.search import trial_age
from uavaou.planners.stationary_duals import stationary_duals
from uavaou.planners.tour import Tour, close_enough_tours, fleet_routes
from uavaou.scenario import Layout
from uavaou.world.ages import AgeLedger
from uavaou.world.coverage import coverage_probability

TINY, QUICKSTART = Scenario.load("tiny"), Scenario.load("quickstart")
MOVES = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)]


@pytest.fixture(autouse=True)
def little_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.planners.anneal.PROPOSALS_A_SLOT", 300)


def small(seed: int) -> Scenario:
    """A random instance that brute force can solve: 1 or 2 UAVs on 2 x 2 to 3 x 2 cells, 5 to 6 slots."""
    rng = np.random.default_rng(seed)
    uavs, devices, slots = int(rng.integers(1, 3)), int(rng.integers(1, 4)), int(rng.integers(4, 7))
    columns, rows = int(rng.integers(1, 3)), 1
    altitudes = [80, 90][:uavs]
    cells = [[100 * int(rng.integers(0, columns + 1)), 100 * int(rng.integers(0, rows + 1))] for _ in range(uavs)]
    return TINY.replace(
        area_x_m=100 * columns,
        area_y_m=100 * rows,
        uavs=uavs,
        altitudes_m=altitudes,
        cds_m=cells,
        devices=devices,
        slots=slots,
        transmit_power_mw=[0.3] * devices,
        layout_seed=seed,
        flight_time_budget_s=(2 * max(altitudes) + 100 * int(rng.integers(0, slots))) / 15,
    )


def least_age(scenario: Scenario) -> int:
    """The optimal total age in slots squared, by dynamic programming over all positions, ages and ways flown."""
    world = World(scenario)
    layout, budget = world.layout(), [int(b) for b in world.flight.budget]
    home = tuple(map(tuple, world.flight.cds.tolist()))
    inside = set(itertools.product(range(scenario.columns), range(scenario.rows)))

    def covered(cells: tuple[tuple[int, int], ...]) -> np.ndarray:
        at = 100.0 * np.array(cells)[None]
        return (world.channel.mean_snr(at) >= world.channel.snr_min).any(axis=1)  # (1, I)

    start = (home, (0,) * scenario.uavs, (1,) * scenario.devices, (0,) * scenario.devices)
    states = {start: 0}
    for slot in range(1, scenario.slots + 1):
        following: dict[object, int] = {}
        for (cells, flown, pending, age), cost in states.items():
            ledger = AgeLedger(1, scenario.devices)
            ledger.pending[0], ledger.age_slots[0] = pending, age
            ledger.advance(slot % layout.update_period[None] == 0, covered(cells))
            spent = cost + int(ledger.age_slots.sum())
            for moves in itertools.product(MOVES, repeat=scenario.uavs):
                there = tuple((x + dx, y + dy) for (x, y), (dx, dy) in zip(cells, moves, strict=True))
                way = tuple(f + (move != (0, 0)) for f, move in zip(flown, moves, strict=True))
                if slot < scenario.slots and all(c in inside for c in there) and all(map(int.__le__, way, budget)):
                    state = (there, way, tuple(ledger.pending[0].tolist()), tuple(ledger.age_slots[0].tolist()))
                    following[state] = min(spent, following.get(state, spent))
            if slot == scenario.slots and cells == home:
                following["end"] = min(spent, following.get("end", spent))
        states = following  # type: ignore[assignment]
    return states["end"]  # type: ignore[index]


def bounds(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The bounds in s by prices, and by copies with prices for each slot, for each slot of a period and for all."""
    layout = scenario.draw_layout()
    found = [LagrangianRelaxation(scenario, layout).ascend()]
    for hold in ("slot", "period", "always"):
        monkeypatch.setattr("uavaou.planners.decomposition._MOST_PRICES", most_prices(scenario, hold))
        copies = LagrangianDecomposition(scenario, layout)
        start = (
            LagrangianRelaxation(scenario, layout).as_charges() if copies.short else stationary_duals(copies, layout)
        )
        found.append(copies.ascend(*start, rounds=200))
    return [total * scenario.slot_length_s / scenario.slots for total in found]


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(4, 12))])
def test_exact_is_the_optimum_by_dynamic_programming(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = small(seed)
    plan = Exact().plan(scenario, scenario.draw_layout())
    optimum = least_age(scenario) * scenario.slot_length_s / scenario.slots
    assert plan.mean_aou_s == pytest.approx(optimum, abs=1e-9)
    assert plan.bound_s == pytest.approx(optimum, abs=1e-9)
    assert broken_rule(scenario, plan.routes) is None
    assert evaluate(Exact(), scenario, 1, seed).mean_aou_s == pytest.approx(optimum, abs=1e-9)
    assert lower_bound(scenario, scenario.draw_layout()).mean_aou_s <= optimum
    for total in bounds(scenario, monkeypatch):
        assert total <= optimum


def test_exact_proves_tiny() -> None:
    plan = Exact(60).plan(TINY, TINY.draw_layout())
    assert plan.gap == 0.0
    for name in PLANNERS:
        assert evaluate(make_planner(name), TINY, 1, 0).mean_aou_s >= plan.mean_aou_s - 1e-9


def test_the_limit_of_exact_covers_the_annealing_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks, given, solve = iter([0.0]), [], Program.solve

    def limited(program: Program, start: Any, time_limit_s: float | None, report: Any) -> Any:
        given.append(time_limit_s)
        return solve(program, start, time_limit_s, report)

    monkeypatch.setattr("uavaou.planners.exact.time", SimpleNamespace(monotonic=lambda: next(ticks, 50.0)))
    monkeypatch.setattr(Program, "solve", limited)
    plan = Exact(60).plan(TINY, TINY.draw_layout())
    assert given == [10.0]
    assert not plan.interrupted


def test_tours_search_longer_only_in_the_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    limits: list[float | None] = []
    monkeypatch.setattr(
        "uavaou.planners.tour.close_enough_tours",
        lambda coverages, limit, _: limits.append(limit) or close_enough_tours(coverages),
    )
    for limit in (1e-6, 1000.0):
        assert not Tour(limit).plan(TINY, TINY.draw_layout()).interrupted
    assert limits[:2] == [None, None]
    assert len(limits) == 3
    assert 0 < limits[2] < 1000


def test_a_limit_that_has_passed_ends_the_tours_and_the_annealing(monkeypatch: pytest.MonkeyPatch) -> None:
    layout, late = TINY.draw_layout(), Tour()
    late.give_up_at = 0.0
    cds = np.array(TINY.cds_m) / TINY.grid_step_m
    assert (late.plan(TINY, layout).routes == cds).all()  # the solver has been stopped
    monkeypatch.setattr("uavaou.planners.anneal.anneal", None)  # a call would fail
    assert (Anneal(1e-6).plan(TINY, layout).routes == best_first_routes(TINY, layout)).all()


def test_exact_refuses_what_it_cannot_do() -> None:
    with pytest.raises(InputError, match="fading = rician: needs a deterministic channel"):
        Exact().plan(QUICKSTART, QUICKSTART.draw_layout())
    unfaded = Scenario.load("paper").replace(fading="none")
    with pytest.raises(InputError, match=r"needs 4,049,460 variables, at most 120,000"):
        Exact().plan(unfaded, unfaded.draw_layout())


@pytest.mark.parametrize("period", [1, 2, 3, 5])
def test_gap_ages_are_those_of_the_ledger(period: int) -> None:
    slots = 9
    found = gap_ages(period, slots)
    for last in range(slots + 1):
        ledger, total = AgeLedger(1, 1), 0
        for slot in range(1, slots + 2):
            if slot > last:
                assert found[last, slot] == total
            if slot <= slots:
                ledger.advance(slot % np.array([[period]]) == 0, np.array([[slot <= last and slot == last]]))
                total += int(ledger.age_slots[0, 0]) if slot > last else 0


@pytest.mark.slow
@pytest.mark.parametrize("scenario", [QUICKSTART, TINY])
@pytest.mark.parametrize("name", ["tour", "partition-tour", "anneal"])
def test_plans_can_be_flown_as_they_are(name: str, scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.planners.anneal.PROPOSALS_A_SLOT", 500)
    for changes in ({}, {"flight_time_budget_s": 30.0}, {"slots": 5}, {"layout_seed": 3}):
        changed = scenario.replace(**changes)
        planner = make_planner(name)
        plan = planner.plan(changed, changed.draw_layout())
        assert broken_rule(changed, plan.routes) is None
        world = World(changed, 3)
        planner.reset(world, 0)
        while not world.done:
            assert (world.cells == plan.routes[world.slot - 1]).all()
            world.step(*planner.act(world))


def closed_length(cells: np.ndarray) -> int:
    return int(np.abs(cells - np.roll(cells, -1, axis=0)).sum())


def test_close_enough_tours_serve_every_device_and_are_near_the_shortest() -> None:
    rng = np.random.default_rng(0)
    coverages = [rng.random((4, 4, 5)) < 0.2 for _ in range(6)]
    coverages[0][..., 2] = False  # out of reach everywhere
    found = close_enough_tours(coverages)
    again = close_enough_tours(coverages)
    lengths, shortest = [], []
    for served, (cells, device), (same, _) in zip(coverages, found, again, strict=True):
        np.testing.assert_array_equal(cells, same)
        assert served[cells[:, 0], cells[:, 1], device].all()
        assert (served[cells[:, 0], cells[:, 1]].any(axis=0) == served.any(axis=(0, 1))).all()
        choices = [np.argwhere(served[..., i]) for i in range(5) if served[..., i].any()]
        tours = ((a, *order) for a, *rest in itertools.product(*choices) for order in itertools.permutations(rest))
        lengths.append(closed_length(cells))
        shortest.append(min(closed_length(np.array(tour)) for tour in tours))
        assert shortest[-1] <= lengths[-1]
    assert sum(lengths) <= 1.2 * sum(shortest)


@pytest.mark.slow
def test_a_time_limit_lets_a_tour_search_on() -> None:
    paper = Scenario.load("paper")
    layout = paper.draw_layout()
    served = coverage_probability(paper, layout).mean(axis=0) >= 0.5  # (X, Y, I)
    (quick, _), (long, _) = (close_enough_tours([served], limit)[0] for limit in (None, 2.0))
    assert closed_length(long) <= closed_length(quick)


@pytest.mark.parametrize("name", ["tour", "partition-tour"])
def test_tours_dwell_where_it_pays(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    layout, planner, seen = QUICKSTART.draw_layout(), make_planner(name), []
    plan = planner.plan(QUICKSTART, layout, seen.append)
    assert seen[-1] == PlanningStatus(1.0, pytest.approx(plan.mean_aou_s))
    assert (plan.routes[1:] == plan.routes[:-1]).all(axis=-1).any()
    monkeypatch.setattr(
        "uavaou.planners.tour._with_dwell_times", lambda scenario, e, tours, _: undwelt(scenario, layout, tours)
    )
    assert plan.mean_aou_s < planner.plan(QUICKSTART, layout).mean_aou_s


def undwelt(scenario: Scenario, layout: Layout, tours: list[np.ndarray]) -> tuple[np.ndarray, float]:
    routes = fleet_routes(scenario, tours, [np.ones(len(tour), dtype=int) for tour in tours])
    return routes, expected_age(scenario, layout, routes).total_age


def test_a_tour_stays_home_where_nothing_is_in_reach() -> None:
    deaf = TINY.replace(rate_min_bit_s=1e9)
    for name in ("tour", "partition-tour"):
        planner = make_planner(name)
        assert (planner.plan(deaf, deaf.draw_layout()).routes == deaf.cds_cells).all()


@pytest.mark.slow
def test_the_expected_age_is_the_mean_over_missions() -> None:
    planner = Anneal()
    found = evaluate(planner, QUICKSTART, 4000, 7).values("mean_aou_s")
    expected = planner.plans[0].mean_aou_s
    assert abs(found.mean() - expected) < 4 * found.std() / np.sqrt(len(found))


def test_a_trial_costs_what_the_changed_routes_do() -> None:
    layout = QUICKSTART.draw_layout()
    routes = np.random.default_rng(0).integers(0, 5, (60, 2, 2))
    other = routes.copy()
    other[20:31, 1] = np.random.default_rng(1).integers(0, 5, (11, 2))
    before, after = expected_age(QUICKSTART, layout, routes), expected_age(QUICKSTART, layout, other)
    work = np.empty((3, 8))
    assert trial_age(before, 1, 21, 32, after.routes[1].copy(), work) == pytest.approx(after.total_age, rel=1e-12)


def test_annealing_improves_is_repeatable_and_reports() -> None:
    layout, seen = QUICKSTART.draw_layout(), []
    plan = Anneal().plan(QUICKSTART, layout, seen.append)
    assert seen[-1].share == 1.0
    assert seen[-1].incumbent_s == pytest.approx(plan.mean_aou_s)
    np.testing.assert_array_equal(plan.routes, Anneal().plan(QUICKSTART, layout).routes)
    for name in ("tour", "partition-tour"):
        planner = make_planner(name)
        assert plan.mean_aou_s < planner.plan(QUICKSTART, layout).mean_aou_s


def test_an_interrupted_annealing_keeps_its_best() -> None:
    def stop(progress: PlanningStatus) -> None:
        raise KeyboardInterrupt

    plan = Anneal().plan(QUICKSTART, QUICKSTART.draw_layout(), stop)
    assert plan.interrupted
    assert broken_rule(QUICKSTART, plan.routes) is None


FLY = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs are started with it ignored
from uavaou.planners.exact import Exact
from uavaou.planners.plan import broken_rule
from uavaou.scenario import Scenario
# Far from being solved when the signal comes: its gap is 40 % after four minutes.
field = {"area_x_m": 400, "area_y_m": 400, "devices": 8, "slots": 48, "flight_time_budget_s": 480}
scenario = Scenario.load("tiny").replace(**field)
plan = Exact(600).plan(scenario, scenario.draw_layout(), lambda progress: print("under way", flush=True))
print(plan.interrupted, broken_rule(scenario, plan.routes), plan.mean_aou_s < 1000)
"""


@pytest.mark.slow
def test_ctrl_c_keeps_the_incumbent_of_exact() -> None:
    with subprocess.Popen([sys.executable, "-c", FLY], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "under way\n"
        process.send_signal(signal.SIGINT)
        last = process.stdout.read().splitlines()[-1]
    assert last == "True None True"
    assert process.returncode == 0


def test_rolling_beats_the_plan_that_it_starts_from(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.planners.rolling._PROPOSALS", 500)
    planned, rolling = Anneal(), Rolling()
    blind, seeing = (evaluate(policy, QUICKSTART, 20, 50).mean_aou_s for policy in (planned, rolling))
    assert seeing < blind


@pytest.mark.slow
@pytest.mark.parametrize("fading", ["rician", "none"])
@pytest.mark.parametrize("seed", [0, 1])
def test_no_policy_beats_the_bound(seed: int, fading: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.planners.bound._ROUNDS_FLEET", 30)
    monkeypatch.setattr("uavaou.planners.rolling._PROPOSALS", 500)
    scenario = QUICKSTART.replace(slots=20, layout_seed=seed, fading=fading, rate_min_bit_s=165_000)
    layout = scenario.draw_layout()
    bounds = [
        lower_bound(scenario, layout).mean_aou_s,
        LagrangianRelaxation(scenario, layout).ascend() * scenario.slot_length_s / 20,
    ]
    assert min(bounds) > 0
    assert bounds[1] <= bounds[0] * (1 + 1e-5)  # the ascent ends at or below the program's optimum, (Time) not binding
    for name in ("greedy", "best-first", "tour", "anneal", "rolling"):
        found = evaluate(make_planner(name), scenario, 30, 0).values("mean_aou_s")
        assert found.mean() + 3 * found.std() / np.sqrt(30) >= max(bounds)


def test_the_relaxation_is_below_the_optimum() -> None:
    layout = TINY.draw_layout()
    program = Program(TINY, layout)
    routes, proven, _ = program.solve(Anneal().plan(TINY, layout).routes)
    total, _ = LagrangianRelaxation(TINY, layout).bound(*program.relaxation())
    assert 0 < total <= proven
    total = expected_mean_aou(TINY, layout, routes) * TINY.slots / TINY.slot_length_s
    assert proven == pytest.approx(total, abs=1e-9)


def test_a_plan_is_read_back(tmp_path: Path) -> None:
    layout: Layout = TINY.draw_layout()
    plan, path = Anneal().plan(TINY, layout), tmp_path / "plan.json"
    path.write_text(json.dumps(plan.to_dict(TINY)))
    loaded, scenario = RoutePlan.load(path)
    np.testing.assert_array_equal(loaded.routes, plan.routes)
    assert (scenario, loaded.mean_aou_s) == (TINY, plan.mean_aou_s)
    assert expected_mean_aou(scenario, layout, loaded.routes) == plan.mean_aou_s
    content = plan.to_dict(TINY)
    content["routes"][0][3] = [2, 2]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="more than one grid step"):
        RoutePlan.load(path)
    path.write_text("{}")
    with pytest.raises(InputError, match="not a plan"):
        RoutePlan.load(path)


def test_time_limits_are_for_planners_that_plan() -> None:
    with pytest.raises(InputError, match="takes no time limit"):
        make_planner("greedy", 1.0)
    assert set(PLAN_AHEAD) < set(PLANNERS)
