"""Outline and zones against literal geometry by shapely and literal breadth-first search."""

from collections import deque
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from uavaou.errors import InputError
from uavaou.evaluation.checker import ViolationCounter, total
from uavaou.planners import PLANNERS, make_planner
from uavaou.planners.anneal import Anneal
from uavaou.planners.bound import lower_bound
from uavaou.planners.exact import Exact
from uavaou.planners.plan import broken_rule
from uavaou.reports.audit import audit
from uavaou.runs.comparison import evaluate
from uavaou.scenario import Scenario
from uavaou.world import World
from uavaou.world.flight import STEP_OF_MOVE, UNLIMITED, Flight, free_moves, ways
from uavaou.world.pull import steps_left
from uavaou.zones import Zone

TINY = Scenario.load("tiny")
ROUNDING_M = 1e-6
FIELD = TINY.replace(
    area_x_m=600,
    area_y_m=500,
    slots=40,
    flight_time_budget_s=240,
    fading="rician",
    uavs=2,
    cds_m=[(0, 0), (600, 0)],
    no_fly=[  # a wall with a gap at the top for UAV 0 (80 m), and a corner that no cell lies in
        {"polygon_m": [(210, -10), (290, -10), (290, 420), (210, 420)], "ceiling_m": 85},
        {"polygon_m": [(440, 240), (460, 240), (460, 260), (440, 260)], "margin_m": 20},
        {"polygon_m": [(440, 190), (460, 190), (460, 210), (440, 210)]},
    ],
)


@st.composite
def star(draw: Any, size: float) -> list[tuple[float, float]]:
    """A simple polygon: corners around a point, which often lie on the grid."""
    count = draw(st.integers(3, 7))
    x, y = draw(st.tuples(st.integers(-2, 6), st.integers(-2, 6)))
    radii = draw(st.lists(st.integers(1, 5), min_size=count, max_size=count))
    turn = draw(st.sampled_from([0.0, 0.1, np.pi / 4]))
    angles = turn + 2 * np.pi * np.arange(count) / count
    corners = np.c_[x + radii * np.cos(angles), y + radii * np.sin(angles)].round(draw(st.sampled_from([0, 2])))
    return [tuple(corner) for corner in (corners * size).tolist()]


@st.composite
def fields(draw: Any) -> Scenario:
    """Small fields with zones; the CDS of each UAV is a free cell."""
    step = draw(st.sampled_from([50.0, 100.0, 0.1 * 3]))
    band = st.one_of(st.none(), st.floats(60, 100))
    zones = []
    for _ in range(draw(st.integers(1, 3))):
        floor, ceiling = draw(band), draw(band)
        if floor is not None and ceiling is not None:
            floor, ceiling = sorted((floor, ceiling))
        zone = {"polygon_m": draw(star(step)), "floor_m": floor, "ceiling_m": ceiling}
        zones.append(zone | {"margin_m": draw(st.sampled_from([0.0, 0.3, 1.0])) * step})
    changes: dict[str, Any] = {"no_fly": zones or None}
    if draw(st.booleans()):
        changes["outline_m"] = draw(star(2 * step))
    x, y = draw(st.tuples(st.integers(1, 6), st.integers(1, 6)))
    cds = [(draw(st.integers(0, x)) * step, draw(st.integers(0, y)) * step) for _ in range(2)]
    budget = draw(st.floats(2 * 90 / 15 + 1, 400))
    try:
        return TINY.replace(
            grid_step_m=step,
            area_x_m=x * step,
            area_y_m=y * step,
            cds_m=cds,
            slots=draw(st.integers(2, 25)),
            flight_time_budget_s=budget,
            fading="rician",
            **changes,
        )
    except InputError:
        return draw(st.nothing())


def literal_free(scenario: Scenario, u: int) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """The cells that are free for a UAV, and where free legs lead from each."""
    cells = [(x, y) for x in range(scenario.columns) for y in range(scenario.rows)]
    beside = {(x, y): [(x + a, y + b) for a, b in STEP_OF_MOVE.tolist() if (x + a, y + b) in cells] for x, y in cells}
    pairs = [(cell, there) for cell, near in beside.items() for there in near]  # of a cell and itself, too
    legs = shapely.linestrings(np.array(pairs) * scenario.grid_step_m)
    free = np.ones(len(pairs), dtype=np.bool_)
    if scenario.outline_m:
        free &= shapely.covers(shapely.Polygon(scenario.outline_m).buffer(ROUNDING_M, join_style="mitre"), legs)
    for zone in scenario.no_fly or ():
        if zone.applies(scenario.altitudes_m[u]):
            free &= shapely.distance(shapely.Polygon(zone.polygon_m), legs) - zone.margin_m > ROUNDING_M
    open_ = {pair for pair, is_free in zip(pairs, free, strict=True) if is_free}
    alone = {cell for cell in cells if (cell, cell) in open_}
    return {cell: [to for to in beside[cell] if cell != to in alone and (cell, to) in open_] for cell in alone}


def literal_steps(legs: dict[tuple[int, int], list[tuple[int, int]]], sources: Any) -> dict[tuple[int, int], int]:
    steps = dict.fromkeys(sources, 0)
    queue = deque(steps)
    while queue:
        cell = queue.popleft()
        for there in legs[cell]:
            if there not in steps:
                steps[there] = steps[cell] + 1
                queue.append(there)
    return steps


@settings(max_examples=150, deadline=None)
@given(fields())
def test_tables_are_those_of_literal_geometry_and_search(scenario: Scenario) -> None:
    free, flight, left = free_moves(scenario), Flight(scenario), steps_left(World(scenario))[0]
    between = ways(scenario)
    for u in range(2):
        legs = literal_free(scenario, u)
        home = literal_steps(legs, [tuple(flight.cds[u].tolist())])
        for c in range(scenario.columns * scenario.rows):
            cell = divmod(c, scenario.rows)
            moves = [(cell[0] + a, cell[1] + b) for a, b in STEP_OF_MOVE.tolist()]
            if free is not None:
                assert free[u, c].tolist() == [cell in legs, *(to in legs.get(cell, ()) for to in moves[1:])]
            assert flight.home[u, c] == home.get(cell, UNLIMITED)
            if home.get(cell, 0) > 0:  # along x before y
                nearer = [m for m in (3, 4, 1, 2) if moves[m] in legs[cell] and home[moves[m]] == home[cell] - 1]
                assert flight.step_home[u, c] == nearer[0]
        for i in range(scenario.devices):
            good = [cell for cell in home if left[u, cell[0] * scenario.rows + cell[1], i] == 0]
            steps = literal_steps(legs, good)
            expected = [steps.get(divmod(c, scenario.rows), np.inf) for c in range(left.shape[1])]
            assert left[u, :, i].tolist() == expected
        if free is not None:
            table = between[min(u, len(between) - 1)]
            for cell in list(legs)[:3]:
                steps = literal_steps(legs, [cell])
                row = table[cell[0] * scenario.rows + cell[1]]
                assert {divmod(c, scenario.rows): n for c, n in enumerate(row.tolist()) if n < 10**6} == steps


@settings(max_examples=100, deadline=None)
@given(fields(), st.integers(0, 10**6))
def test_no_policy_flies_a_closed_leg_and_all_come_home(scenario: Scenario, seed: int) -> None:
    world, checker = World(scenario, 4, seed), ViolationCounter(scenario, 4, seed)
    rng, legs = np.random.default_rng(seed), [literal_free(scenario, u) for u in range(2)]
    while not world.done:
        before, allowed = world.cells.copy(), world.allowed_moves
        assert allowed.any(axis=-1).all()
        moves = rng.integers(5, size=(4, 2))
        checker.observe(world, world.step(moves))
        for n, u in np.ndindex(4, 2):
            here, there = (tuple(cells[n, u].tolist()) for cells in (before, world.cells))
            assert there == here or there in legs[u][here]
            off_grid = not ((before[n, u] + STEP_OF_MOVE[moves[n, u]] >= 0).all())
            if allowed[n, u, moves[n, u]] and not off_grid:
                assert there == tuple((before[n, u] + STEP_OF_MOVE[moves[n, u]]).tolist())
    assert sum(total(checker.finish(world)).values()) == 0


def test_a_leg_between_free_cells_may_cross_a_corner_and_the_border_is_closed() -> None:
    scenario = FIELD.replace(grid_step_m=100)
    legs = literal_free(scenario, 1)
    assert (4, 2) in legs
    assert (5, 2) in legs
    assert (5, 2) not in legs[4, 2]
    free = free_moves(FIELD.replace(no_fly=[{"polygon_m": [(0, 200), (300, 200), (300, 300)]}]))
    assert free is not None
    assert not free[0, 3 * 6 + 2].any()  # (300, 200) is a corner


@pytest.mark.parametrize("broken", [(3, 3), (1, 1)])
def test_the_checker_finds_what_flies_through_a_zone_or_out_of_the_outline(broken: tuple[int, int]) -> None:
    open_air = FIELD.replace(no_fly=None)
    outline = [(0, 0), (600, 0), (600, 500), (300, 500), (300, 150), (0, 150)]
    closed = FIELD if broken[0] == 3 else open_air.replace(outline_m=outline)
    for scenario, caught in ((open_air, 0), (closed, 1)):
        world, checker = World(open_air, 1, 0), ViolationCounter(scenario, 1, 0)
        moves = [[broken[0], 0]] * 3
        while not world.done:
            checker.observe(world, world.step(np.array([moves[min(world.slot - 1, 2)] if world.slot < 4 else [0, 0]])))
        assert (checker.finish(world)[0]["bounds"] > 0) == caught


def test_without_shapely_the_checker_uses_the_geometry_of_the_world(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "shapely", None)
    test_the_checker_finds_what_flies_through_a_zone_or_out_of_the_outline((3, 3))


def test_a_cds_in_a_zone_is_refused_and_a_device_there_is_reported() -> None:
    zone = {"polygon_m": [(-50, -50), (50, -50), (50, 50), (-50, 50)], "name": "yard"}
    with pytest.raises(InputError, match=r"cds_m\[0\] = \[0, 0\]: lies in no_fly\[0\], which breaks constraint"):
        FIELD.replace(no_fly=[zone])
    with pytest.raises(InputError, match=r"cds_m\[1\] = \[600, 0\]: lies outside of outline_m"):
        FIELD.replace(outline_m=[(0, 0), (500, 0), (500, 500), (0, 500)])
    assert FIELD.replace(no_fly=[zone | {"ceiling_m": 85}], cds_m=[(600, 0), (0, 0)]).no_fly is not None
    places = [(100.0, 100.0), (450.0, 400.0), (150.0, 150.0), (100.0, 150.0)]
    far = {"polygon_m": [(250, 200), (700, 200), (700, 600), (250, 600)]}
    found = audit(FIELD.replace(devices_m=places, no_fly=[far], fading="none")).findings
    assert any("device 1: no free cell can serve it" in finding.message for finding in found)
    assert any("outline and zones close 16 of 42 cells." in finding.message for finding in found)


@pytest.mark.parametrize("name", sorted(PLANNERS.keys() - {"exact"}))
def test_planners_fly_around_zones_or_refuse_in_a_line(name: str) -> None:
    planner: Any = make_planner(name, 1.0 if name in ("anneal", "local-greedy-tuned", "rolling") else None)
    if name in ("tour", "partition-tour"):
        with pytest.raises(InputError, match=f"^{name}: scenario 'tiny' has an outline or zones"):
            evaluate(planner, FIELD, episodes=2)
        return
    assert sum(evaluate(planner, FIELD, episodes=4).violations.values()) == 0


def test_the_exact_plan_is_no_worse_than_an_annealed_one_and_not_below_the_bound() -> None:
    scenario = FIELD.replace(fading="none", slots=12, flight_time_budget_s=100, update_period_slots=2)
    layout = scenario.draw_layout()
    exact, annealed = Exact().plan(scenario, layout), Anneal().plan(scenario, layout)
    assert broken_rule(scenario, exact.routes) is None
    assert lower_bound(scenario, layout, 3.0).mean_aou_s <= exact.mean_aou_s + 1e-6
    assert exact.mean_aou_s <= annealed.mean_aou_s + 1e-6
    through = exact.routes.copy()
    through[1:3, 0] = [[0, 0], [0, 0]]
    through[3:9, 0] = [[1, 0], [2, 0], [3, 0], [2, 0], [1, 0], [0, 0]]
    through[9:, 0] = 0
    assert broken_rule(scenario, through) == "a route leaves outline_m, or crosses a zone of no_fly"


def test_a_zone_that_no_altitude_meets_changes_nothing() -> None:
    zone = Zone(polygon_m=((0.0, 0.0), (600.0, 0.0), (600.0, 500.0), (0.0, 500.0)), floor_m=100.0)
    for name in ("best-first", "local-greedy-parts", "local-greedy"):
        scenarios = (FIELD.replace(no_fly=zones) for zones in (None, [zone]))
        ages = [evaluate(name, scenario, episodes=3).values("mean_aou_s") for scenario in scenarios]
        assert np.array_equal(*ages), name
