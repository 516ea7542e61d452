"""``local-greedy-tuned``: its simulated missions are the World's, and its search keeps what it promises."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.strategies import scenarios
from uavaou import Scenario, World, evaluate
from uavaou.planners import tuned
from uavaou.planners.plan import PlanningStatus
from uavaou.planners.tuned import LocalGreedyTuned, RulePlan, _Search
from uavaou.world.patrol import fly_fleet, patrol_area

pytestmark = pytest.mark.slow

QUICK = Scenario.load("quickstart").replace(slots=20)


def drawn_rule(scenario: Scenario, seed: int) -> RulePlan:
    """A rule with any pull."""
    rng, pairs = np.random.default_rng(seed), (scenario.uavs, scenario.devices)
    pull = rng.random((scenario.uavs, scenario.columns * scenario.rows, scenario.devices))
    pull *= (rng.random(pairs) < 0.7)[:, None]
    return RulePlan("local-greedy-tuned", 0.0, pull[:, 0], np.ones(pairs), np.ones(pairs), pull)


def flown_and_simulated(scenario: Scenario, plan: RulePlan, missions: int) -> tuple[np.ndarray, np.ndarray]:
    """The mean ages of a rule in slots, in the World and by the kernel, (missions,) each."""
    layout, planner = scenario.draw_layout(), LocalGreedyTuned()
    planner.keep(plan, scenario, layout)
    flown = evaluate(planner, scenario, missions)
    assert not any(flown.violations.values())
    return flown.values("mean_aou_s") / scenario.slot_length_s, simulated(World(scenario), plan, missions)


def simulated(world: World, plan: RulePlan, missions: int) -> np.ndarray:
    scenario, fleet = world.scenario, np.arange(world.scenario.uavs)
    headroom = (world.channel.mean_snr_above() / world.channel.snr_min[:, None, :])[0]
    positions = world.device_positions[0] / scenario.grid_step_m
    draws = max(missions, scenario.uavs)
    area = patrol_area(scenario, world.flight.cds, positions, headroom, world.update_period[0], draws)
    serves, pull = np.zeros((len(fleet), area.pull.shape[2]), np.float32), np.zeros_like(area.pull)
    serves[:, : scenario.devices], pull[..., : scenario.devices] = plan.weight > 0, plan.pull
    routes, ages = np.zeros((len(fleet), missions, scenario.slots), np.int32), np.empty(missions)
    fly_fleet(area, fleet, serves, pull, 0, routes, ages)
    some = np.empty(missions - missions // 3)  # of these UAVs nobody flies anew, and of these missions the last alone
    fly_fleet(area, fleet[:0], serves, pull, missions // 3, routes, some)
    np.testing.assert_array_equal(some, ages[missions // 3 :])
    return ages


@settings(max_examples=10)
@given(scenarios(), st.integers(0, 99))
def test_without_fading_a_simulated_mission_is_the_world_s(scenario: Scenario, seed: int) -> None:
    scenario = scenario.replace(fading="none", layout="fixed")
    flown, simulated = flown_and_simulated(scenario, drawn_rule(scenario, seed), 1)
    np.testing.assert_allclose(simulated, flown, rtol=1e-6)  # sums in single precision


def test_with_fading_simulated_missions_have_the_world_s_mean() -> None:
    flown, simulated = flown_and_simulated(QUICK, drawn_rule(QUICK, 5), 400)
    error = np.hypot(flown.std(), simulated.std()) / 20.0
    assert abs(flown.mean() - simulated.mean()) < 4.0 * error < 0.3 * flown.mean()


def test_uavs_over_the_same_devices_have_draws_of_their_own() -> None:
    hovering = QUICK.replace(cds_m=[[300, 300]] * QUICK.uavs)
    rule = drawn_rule(hovering, 0)
    still = RulePlan(rule.planner, 0.0, rule.weight, rule.reach, rule.share, np.zeros_like(rule.pull))
    flown, simulated = flown_and_simulated(hovering, still, 400)
    error = np.hypot(flown.std(), simulated.std()) / 20.0
    assert abs(flown.mean() - simulated.mean()) < 4.0 * error


def test_the_same_work_gives_the_same_plan_which_is_no_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou.planners.tuned.PROPOSALS", 1200)
    statuses: list[PlanningStatus] = []
    short = Scenario.load("paper").replace(slots=60)
    one = LocalGreedyTuned().plan(short, short.draw_layout(), statuses.append)
    two = LocalGreedyTuned().plan(short, short.draw_layout())
    assert one.to_dict(short) == json.loads(json.dumps(two.to_dict(short)))
    same_draws = [status.incumbent_s for status in statuses if status.share <= tuned._DRAWS[0][0]]
    assert same_draws == sorted(same_draws, reverse=True)
    assert same_draws[0] > same_draws[-1]


def test_with_more_draws_all_go_on_from_the_best_numbers() -> None:
    search = _Search(QUICK, QUICK.draw_layout())
    parts, nearest = search._chains
    assert not np.array_equal(parts.best, nearest.best)
    for _ in range(3):
        search.step(0.1)
    best = search._best().copy()
    assert not np.array_equal(parts.best, nearest.best)
    search._go_on(0.5)
    assert len(parts._ages) == len(nearest._ages) == tuned._DRAWS[1][1]
    np.testing.assert_array_equal(np.stack([parts.best, nearest.best]), np.stack([best, best]))


@settings(max_examples=3, deadline=None)
@given(scenarios(max_slots=8))
def test_every_scenario_can_be_tuned_and_flown(scenario: Scenario) -> None:
    scenario = scenario.replace(layout="fixed")
    planner = LocalGreedyTuned()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uavaou.planners.tuned.PROPOSALS", 10)
        assert not any(evaluate(planner, scenario, 2).violations.values())


def test_the_time_limit_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(s=0.0)

    def monotonic() -> float:
        clock.s += 0.01
        return float(clock.s)

    monkeypatch.setattr("uavaou.planners.tuned.time", SimpleNamespace(monotonic=monotonic))
    shares: list[float] = []
    LocalGreedyTuned(0.5).plan(QUICK, QUICK.draw_layout(), lambda status: shares.append(status.share))
    assert clock.s < 0.53
    assert 40 < len(shares) < 52
    assert shares == sorted(shares)


def test_ctrl_c_keeps_the_best_rule() -> None:
    def interrupt(status: PlanningStatus) -> None:
        raise KeyboardInterrupt

    planner = LocalGreedyTuned()
    plan = planner.plan(QUICK, QUICK.draw_layout(), interrupt)
    assert plan.interrupted
    planner.keep(plan, QUICK, QUICK.draw_layout())
    assert evaluate(planner, QUICK, 2).mean_aou_slots > 0
