"""The plan that a training on one map begins with, and policies that fly map after map."""

import json
import shutil
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th

from tests.runs.stopped_runs import small
from uavaou import MAPPO, InputError, RunConfig, Scenario, World, evaluate, flatten, load_run, train
from uavaou.algorithms.registry import load_config, make_model
from uavaou.planners import make_planner
from uavaou.planners.tuned import LocalGreedyTuned, RulePlan, _Search
from uavaou.runs.folder import RunFolder
from uavaou.runs.policy import TrainedPolicy
from uavaou.runs.pull_plan import plan_of
from uavaou.runs.start import Start
from uavaou.world.partition import survivors
from uavaou.world.pull import PullPlan, planned_steps, steps_left

PAPER = Scenario.load("paper")
SETTINGS: dict[str, Any] = {
    "network": "set",
    "pull": 60,
    "token_width": 8,
    "hidden": [16],
    "collection": "auto",
    "plan_slots": 200_000,
    "slots": 3000,
    "missions": 4,
    "rollout_slots": 50,
    "evaluation_missions": 4,
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    folder = tmp_path_factory.mktemp("planned") / "run"
    return train(RunConfig.load("mappo", "quickstart", **SETTINGS), folder).folder


@cache
def searched(name: str) -> RulePlan:
    scenario = Scenario.load(name)
    return LocalGreedyTuned(slots=100_000).plan(scenario, scenario.draw_layout())


def test_the_search_ends_with_its_slots() -> None:
    layout = PAPER.draw_layout()
    again = LocalGreedyTuned(slots=100_000).plan(PAPER, layout)
    np.testing.assert_array_equal(searched("paper").pull, again.pull)
    search = _Search(PAPER, layout)
    whole = 2 * 16 * PAPER.slots * 3 * 1.5  # both starts: each UAV's flight, and half as much to see what they leave
    assert search.slots == whole // 24


def test_the_search_grows_with_the_root_of_the_budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def noting(slots: int) -> LocalGreedyTuned:
        asked.append(slots)
        return LocalGreedyTuned(slots=1)

    monkeypatch.setattr("uavaou.runs.pull_plan.LocalGreedyTuned", noting)
    for budget in (500_000, 125_000, 2_000_000):
        plan_of(RunConfig.load("mappo", "quickstart", **SETTINGS | {"slots": budget}), RunFolder(tmp_path))
    assert asked == [200_000, 100_000, 400_000]


def test_planned_steps_are_the_plan_s_pull_and_a_new_policy_flies_it() -> None:
    layout = PAPER.draw_layout()
    tuned, plan, world = LocalGreedyTuned(), searched("paper"), World(PAPER, 4, 3)
    of_map = plan.of_map(PAPER, layout)
    steps = planned_steps(world, [of_map])[0].astype(np.float64)  # (U, C, I)
    serves = of_map.serves[:, None] & np.ones(steps.shape, dtype=np.bool_)
    np.testing.assert_allclose(np.exp(-steps)[serves], plan.pull[serves], rtol=1e-4, atol=1e-12)
    np.testing.assert_array_equal(steps[~serves], steps_left(world)[0][~serves])
    env = flatten(PAPER, 1, collection="auto", rows="entities", plan=of_map)
    policy: Any = MAPPO(env=env, seed=0, policy_kwargs={"network": "set", "pull": 60.0}).policy
    tuned.keep(plan, PAPER, layout)
    tuned.reset(world, 3)
    same = made = 0
    while not world.done:
        moves, _ = tuned.act(world)
        rows = th.from_numpy(env.views.local(world).reshape(-1, env.local_size))
        same += int((policy.act(rows, None).numpy().reshape(moves.shape) == moves).sum())
        made += moves.size
        world.step(moves)
    assert same > 0.99 * made


def test_a_run_keeps_its_plan_and_flies_it(run: RunFolder) -> None:
    config = run.read_config()
    views: Any = load_run(run).views
    assert views.plan is not None
    kept, flown = json.loads(run.plan.read_text()), evaluate(load_run(run), config.scenario, episodes=3).mean_aou_slots
    run.plan.unlink()  # found anew, it is the same
    again = plan_of(config, run)
    assert again.to_dict() == kept
    assert evaluate(load_run(run), config.scenario, episodes=3).mean_aou_slots == flown
    run.plan.write_text(json.dumps(kept))


def test_a_run_keeps_its_sharpness_and_does_not_plan_other_maps(run: RunFolder) -> None:
    start = Start.at(run)
    with pytest.raises(
        InputError, match=r"algorithm\.pull = 12\.0 does not fit its weights, which were trained with 60"
    ):
        start.training(Scenario.load("quickstart"), {"pull": 12.0}, seed=0)
    assert load_run("any-map").plans_maps
    assert not load_run(run).plans_maps


def test_a_plan_in_a_folder_without_a_run_is_left_aside(run: RunFolder, tmp_path: Path) -> None:
    config, stray = run.read_config(), RunFolder(tmp_path)
    stray.plan.write_text("{}")
    found, kept = plan_of(config, stray), plan_of(config, run)
    assert found.to_dict() == kept.to_dict()
    stray.config.write_text(run.config.read_text())  # then it is the run's, and damaged
    with pytest.raises(InputError, match="is no plan of pulls"):
        plan_of(config, stray)


def test_on_another_map_the_plan_is_left_aside(run: RunFolder) -> None:
    config = run.read_config()
    plan, other = plan_of(config, run), config.scenario.replace(layout_seed=7)
    assert plan.for_maps(World(config.scenario)) == [plan]
    assert plan.for_maps(World(other)) is None
    assert plan.for_maps(World(config.scenario.replace(layout="resample"), 2)) is None
    planned, plain = (flatten(other, 2, rows="entities", plan=of) for of in (plan, None))
    np.testing.assert_array_equal(planned.reset(), plain.reset())
    assert evaluate(load_run(run), other.replace(uavs=1, altitudes_m=[90], cds_m=[[0, 0]]), episodes=1).mean_aou_s > 0


def test_where_maps_vary_each_has_a_plan_and_a_longer_one_in_flight(tmp_path: Path) -> None:
    varied = Scenario.load("quickstart").replace(layout="resample")
    config = RunConfig.load("mappo", varied, **SETTINGS | {"map_plan_slots": 10_000})
    plans, longer = (plan_of(config, RunFolder(tmp_path), in_flight=flown) for flown in (False, True))
    assert longer._slots == 16 * plans._slots == 160_000
    world = World(varied, 3, 5)
    found = plans.for_maps(world)
    for mission, plan in enumerate(found):
        slots = 10_000 * 25 // varied.devices
        alone = LocalGreedyTuned(slots=slots).plan(varied, world.layout(mission))
        np.testing.assert_array_equal(plan.weight, alone.weight)
    again = plans.for_maps(World(varied, 3, 5))
    assert all(one is two for one, two in zip(found, again, strict=True))  # kept
    steps, single = planned_steps(world, found), Scenario.load("quickstart").pinned(world.layout(1))
    np.testing.assert_array_equal(steps[1], planned_steps(World(single), [found[1]])[0])
    env = flatten(varied, 3, seed=5, rows="entities", plan=plans)
    env.reset()
    np.testing.assert_array_equal(env.venv.vec_envs[0].views._parts.serves, [plan.serves for plan in found])
    alive = np.array([False, True])
    of_one = plans.for_survivors(world, 1, alive)
    wanted = LocalGreedyTuned(slots=slots).plan(survivors(varied, alive), world.layout(1))
    np.testing.assert_array_equal(of_one.weight, [np.zeros(8), wanted.weight[0]])
    np.testing.assert_array_equal(of_one.reach[1], wanted.reach[0])
    large = Scenario.load("paper").replace(grid_step_m=2.5)
    assert plans.for_maps(World(large)) is None


def test_no_plan_is_made_where_none_is_asked_for(tmp_path: Path) -> None:
    config = RunConfig.load("mappo", Scenario.load("quickstart").replace(layout="resample"), **SETTINGS)
    assert plan_of(config, RunFolder(tmp_path)) is None  # a plan of each map is asked for by another name
    for field in ("plan_slots", "pull"):
        config = RunConfig.load("mappo", "quickstart", **SETTINGS | {field: 0})
        assert plan_of(config, RunFolder(tmp_path)) is None


@pytest.mark.parametrize(
    "change", [{"weight": "x"}, {"reach": [[0.0]]}, {"share": None}, {"cds": [[0]]}, {"devices_m": []}]
)
def test_a_damaged_plan_is_refused_in_a_line(change: dict[str, Any]) -> None:
    one = {"weight": [[1.0]], "reach": [[1.0]], "share": [[0.5]], "cds": [[0, 0]], "devices_m": [[1.0, 2.0]]}
    assert PullPlan.from_dict(one, "plan.json").serves.all()
    with pytest.raises(InputError, match=r"^'plan\.json' is no plan of pulls: "):
        PullPlan.from_dict(one | change, "plan.json")


@pytest.mark.parametrize("planned", [True, False])
def test_missions_that_each_need_a_plan_first_are_told_a_few_at_a_time(planned: bool) -> None:
    varied = Scenario.load("tiny").replace(layout="resample")
    told: list[int] = []
    policy = LocalGreedyTuned(slots=1) if planned else make_planner("local-greedy-parts")
    flown = evaluate(policy, varied, 6, after_slot=lambda slots, world: told.append(slots))
    slots = varied.slots
    groups = (4, 2) if planned else (6,)
    ends = np.cumsum(groups) * slots
    firsts = ends - np.multiply(groups, slots)
    assert told == [first + n * group for first, group in zip(firsts, groups, strict=True) for n in range(1, slots + 1)]
    alone = [evaluate(policy, varied, 1, seed=10_000 + n).mean_aou_s for n in range(6)]
    np.testing.assert_array_equal(flown.values("mean_aou_s"), alone)


@pytest.mark.parametrize("name", ["paper", "quickstart"])
def test_hearing_the_others_takes_no_uav_off_its_plan(name: str) -> None:
    """Before anything is learned: true ages of foreign devices once drew UAVs there, which cost 8 %."""
    scenario = Scenario.load(name)
    plan = searched(name).of_map(scenario, scenario.draw_layout())
    aou = []
    for level in ("local", "shared"):
        config = load_config("mappo", {"observation": level})
        env = flatten(scenario, 1, observation=level, collection=config.collection, rows=config.rows, plan=plan)
        policy = TrainedPolicy(make_model(config, env, seed=0, device="cpu"), env.views)
        aou.append(evaluate(policy, scenario, 8).mean_aou_slots)
    assert aou[1] == pytest.approx(aou[0], rel=0.03)


QUICK = Scenario.load("quickstart").replace(slots=40)
MAPS: list[dict[str, Any]] = [
    {"devices": 5},
    {"slots": 60},
    {"layout_seed": 4},
    {"uavs": 1, "altitudes_m": [80], "cds_m": [[0, 0]]},
    {"layout": "resample"},
    {"rate_min_bit_s": 2 * QUICK.rate_min_bit_s},
]


def ages(policy: Any, scenario: Scenario) -> list[float]:
    return evaluate(policy, scenario, episodes=2).values("mean_aou_s").tolist()


@pytest.mark.usefixtures("quick_plans")
@pytest.mark.parametrize(("action", "maps"), [("greedy", MAPS), ("sample", MAPS[:2])])
def test_one_policy_flies_map_after_map(action: str, maps: list[dict[str, Any]]) -> None:
    policy = load_run("any-map", action=action)
    for scenario in [QUICK.replace(**change) for change in maps] + [QUICK]:
        assert ages(policy, scenario) == ages(load_run("any-map", scenario, action), scenario), scenario
    assert ages(load_run("any-map", "tiny", action), QUICK) == ages(policy, QUICK)


@pytest.mark.parametrize("algorithm", ["mappo", "vdn"])
@pytest.mark.parametrize("network", ["mlp", "set"])
def test_every_learners_policy_flies_what_it_fits_and_refuses_the_rest(
    algorithm: str, network: str, tmp_path: Path
) -> None:
    budget = {"slots": 64, "missions": 2, "evaluation_missions": 1, "hidden": [8], "network": network}
    config = RunConfig(QUICK, load_config(algorithm, budget))
    train(config, tmp_path / "run")
    policy = load_run(tmp_path / "run")
    longer, fewer = QUICK.replace(slots=60, layout_seed=4), QUICK.replace(devices=5)
    assert ages(policy, longer) == ages(load_run(tmp_path / "run", longer), longer)
    if network == "set":
        assert ages(policy, fewer) == ages(load_run(tmp_path / "run", fewer), fewer)
    else:
        with pytest.raises(InputError, match="trained with 2 uavs and 8 devices; scenario 'quickstart' has 2 and 5"):
            evaluate(policy, fewer)
    assert ages(policy, QUICK) == ages(load_run(tmp_path / "run"), QUICK)  # a refusal leaves it as it was


def test_a_training_at_work_changes_no_policy_that_is_loaded(runs: tuple[RunFolder, RunFolder], tmp_path: Path) -> None:
    folder, scenario = RunFolder(Path(shutil.copytree(runs[0].path, tmp_path / "run"))), small().scenario
    loaded, other = load_run(folder), scenario.replace(layout_seed=9)
    wanted = ages(load_run(folder, other), other)
    train(small(hidden=[16]), tmp_path / "later")
    RunFolder(tmp_path / "later").best.replace(folder.best)
    assert ages(loaded, other) == wanted
