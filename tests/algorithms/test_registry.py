"""Algorithms by name: how one's own is registered, what is refused, and that every command then takes it."""

import shlex
from collections.abc import Iterator
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.vec_env import VecNormalize

from tests.cli.commands import Shell
from tests.runs.stopped_runs import assert_ends_as, stopped_at
from uavaou import (
    AlgorithmConfig,
    InputError,
    LocalRows,
    RunConfig,
    Scenario,
    evaluate,
    flatten,
    load_run,
    register_algorithm,
    train,
)
from uavaou.algorithms import registry
from uavaou.evaluation.flights import Flights
from uavaou.reports.figures import read_runs
from uavaou.runs.folder import RunFolder
from uavaou_cli.main import main

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "plain_ppo.py"
PLUGIN = f"--plugin {EXAMPLE}"
SMALL = {"slots": 400, "missions": 4, "evaluate_every_slots": 200, "evaluation_missions": 2}


@pytest.fixture(autouse=True)
def _registered_alone() -> Iterator[None]:
    """What a test registers is gone after it."""
    algorithms, plugins = dict(registry._ALGORITHMS), set(registry._PLUGINS)
    yield
    registry._ALGORITHMS.clear()
    registry._ALGORITHMS.update(algorithms)
    registry._PLUGINS.clear()
    registry._PLUGINS.update(plugins)


class OwnConfig(AlgorithmConfig):
    slots: int = 400
    missions: int = 4
    evaluate_every_slots: int = 200
    evaluation_missions: int = 2
    rollout_slots: int = 25


def ppo(config: Any, env: Any, seed: int, device: str) -> PPO:
    rows = config.rollout_slots * env.num_envs
    return PPO("MlpPolicy", LocalRows(env), n_steps=config.rollout_slots, batch_size=rows, seed=seed, device=device)


def on_whole_rows(config: Any, env: Any, seed: int, device: str) -> PPO:
    return PPO("MlpPolicy", env, n_steps=8, batch_size=8, device=device)


def on_normalised_rows(config: Any, env: Any, seed: int, device: str) -> PPO:
    return PPO("MlpPolicy", VecNormalize(LocalRows(env)), n_steps=8, batch_size=8, device=device)


def dqn(config: Any, env: Any, seed: int, device: str) -> DQN:
    return DQN("MlpPolicy", LocalRows(env), buffer_size=2000, learning_starts=100, seed=seed, device=device)


def own(name: str = "own", **changes: Any) -> RunConfig:
    scenario = Scenario.load("quickstart").replace(slots=20)
    return RunConfig(scenario, registry.load_config(name, SMALL | changes), 0)


@pytest.mark.slow
def test_the_example_trains_is_evaluated_and_drawn_by_name(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = "--set algorithm.missions=4 --set algorithm.rollout_slots=64 --set algorithm.evaluation_missions=2"
    out = shell.done(f"{PLUGIN} train --scenario quickstart --algorithm plain-ppo --slots 600 --quiet {settings}")
    following = shlex.split(out.split("next:")[1])
    assert following[1:3] == ["--plugin", str(EXAMPLE)]
    shell.out(shlex.join([*following[1:], "--episodes", "2", "--quiet"]))
    (run,) = tmp_path.glob("results/quickstart/plain-ppo+*/seed-0")
    assert "plain-ppo" in set(Flights.read(run).flights["policy"])
    assert shell(f"{PLUGIN} plot trajectories {run}")[0] == 0
    assert read_runs([run]).on_several_processors("quickstart") is False


def test_a_run_folder_imports_nothing(shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    register_algorithm("own", OwnConfig, ppo)
    train(own(), RunFolder(tmp_path / "run"))
    del registry._ALGORITHMS["own"]
    (tmp_path / "own.py").write_text("raise SystemExit('imported')\n")
    err = shell.refused("eval run")
    assert err.count("\n") == 1
    assert "algorithm.name = 'own'" in err
    assert "uavaou --plugin FILE.py" in err


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("--plugin nowhere.py train", "plugin 'nowhere.py': no such file"),
        ("--plugin nowhere.module train", "plugin 'nowhere.module': no such module"),
        ("--plugin .. train", "plugin '..': no such module"),
        ("--plugin empty.py train", "registers no algorithm"),
        ("--plugin twice.py train", "algorithm 'mappo' is registered already"),
        ("train --plugin empty.py", "--plugin stands before the command"),
        (f"{PLUGIN} train --algorithm plain-pop", "did you mean 'plain-ppo'?"),
        (f"{PLUGIN} train --algorithm plain-ppo --set algorithm.minibatch=2", "did you mean 'minibatches'?"),
        (f"{PLUGIN} train --algorithm plain-ppo --set algorithm.gamma=x", "gamma = 'x'"),
    ],
)
def test_bad_plugins_are_one_line(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.py").write_text("")
    (tmp_path / "twice.py").write_text(
        "from uavaou import AlgorithmConfig, register_algorithm\n"
        "register_algorithm('mappo', AlgorithmConfig, lambda *_: None)\n"
    )
    err = shell.refused(command)
    assert err.count("\n") == 1
    assert says in err


def test_a_plugins_own_error_keeps_its_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "faulty.py").write_text("import nothing_of_that_name\n")
    with pytest.raises(ModuleNotFoundError, match="nothing_of_that_name"):
        main(["--plugin", str(tmp_path / "faulty.py"), "train"])
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="nothing_of_that_name"):
        main(["--plugin", "faulty", "train"])


def test_a_plugin_imports_what_lies_beside_it(tmp_path: Path) -> None:
    (tmp_path / "beside_it.py").write_text("NAME = 'with-neighbour'\n")
    (tmp_path / "own.py").write_text(
        "from beside_it import NAME\nfrom uavaou import AlgorithmConfig, register_algorithm\n"
        "register_algorithm(NAME, AlgorithmConfig, print)\n"
    )
    for _ in range(2):  # the second time, it is there already
        registry.load_plugin(str(tmp_path / "own.py"))
    assert "with-neighbour" in registry.algorithm_names()


def test_an_installed_package_offers_its_algorithms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "from uavaou import AlgorithmConfig, register_algorithm\n"
    (tmp_path / "offering.py").write_text(text + "register_algorithm('offered', AlgorithmConfig, print)\n")
    (tmp_path / "silent.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    offered = [
        EntryPoint("offered", "offering", "uavaou.algorithms"),
        EntryPoint("hush", "silent", "uavaou.algorithms"),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda **which: EntryPoints(offered).select(**which))
    assert registry.algorithm_names()[-2:] == ["hush", "offered"]
    assert "offered" not in registry._ALGORITHMS  # imported when it is wanted, not before
    assert registry.find_algorithm("offered").config is AlgorithmConfig
    with pytest.raises(InputError, match="silent should register it"):
        registry.find_algorithm("hush")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("Own", OwnConfig, ppo), "expected lower-case letters"),
        (("../own", OwnConfig, ppo), "expected lower-case letters"),
        (("ippo", OwnConfig, ppo), "registered already"),
        (("own", dict, ppo), "expected a subclass of uavaou.AlgorithmConfig"),
    ],
)
def test_what_cannot_be_registered(arguments: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        register_algorithm(*arguments)


@pytest.mark.parametrize(
    ("build", "says"), [(on_whole_rows, r"a UAV sees \(53,\)"), (on_normalised_rows, "VecNormalize")]
)
def test_a_policy_that_no_uav_could_fly_is_refused(build: Any, says: str, tmp_path: Path) -> None:
    register_algorithm("own", OwnConfig, build)
    with pytest.raises(InputError, match=says):
        train(own(), RunFolder(tmp_path / "run"))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("collection", ["select", pytest.param("auto", marks=pytest.mark.slow)])
def test_a_resumed_run_of_ones_own_is_the_run_never_stopped(collection: str, tmp_path: Path) -> None:
    register_algorithm("own", OwnConfig, ppo)
    config = own(collection=collection)
    whole, parted = RunFolder(tmp_path / "whole"), RunFolder(tmp_path / "parted")
    train(config, whole)
    with stopped_at(300):
        train(config, parted, checkpoint_every_s=0)
    train(config, parted, resume=True)
    assert_ends_as(parted, whole)


@pytest.mark.parametrize(("build", "collection"), [(ppo, "select"), (ppo, "auto"), (dqn, "auto")])
def test_a_missions_result_does_not_depend_on_the_missions_beside_it(
    build: Any, collection: str, tmp_path: Path
) -> None:
    register_algorithm("own", OwnConfig, build)
    config = own(collection=collection)
    train(config, RunFolder(tmp_path))
    for action in ("greedy", "sample"):
        policy = load_run(RunFolder(tmp_path), action=action)
        th.manual_seed(1)
        many = evaluate(policy, config.scenario, 4, 500).values("mean_aou_s")
        th.manual_seed(2)
        alone = [evaluate(policy, config.scenario, 1, 500 + j).mean_aou_s for j in range(4)]
        np.testing.assert_array_equal(many, alone, err_msg=action)


@pytest.mark.parametrize("collection", ["select", "auto"])
def test_drawn_actions_have_the_policys_probabilities(collection: str) -> None:
    from uavaou.runs.policy import _act

    env = flatten("tiny", missions=1, collection=collection)
    model = PPO("MlpPolicy", LocalRows(env), n_steps=8, batch_size=8, device="cpu", seed=0)
    with th.no_grad():
        model.policy.action_net.bias.uniform_(-1, 1)
    local = th.from_numpy(model.env.reset())[:1]
    devices = env.row_layout.devices if collection == "select" else 0
    uniforms = th.rand((20_000, 5 + devices), generator=th.Generator().manual_seed(0))
    drawn = _act(model, local.expand(20_000, -1), uniforms, env.row_layout).reshape(20_000, -1)
    parts = model.policy.get_distribution(local).distribution
    for k, part in enumerate(parts if isinstance(parts, list) else [parts]):
        shares = th.bincount(drawn[:, k], minlength=part.probs.shape[1]) / 20_000
        th.testing.assert_close(shares, part.probs[0].detach(), atol=0.015, rtol=0)


def test_local_rows_are_the_first_columns_at_the_end_of_a_mission_too() -> None:
    whole, local = (flatten("tiny", missions=2, seed=3) for _ in range(2))
    cut = LocalRows(local)
    np.testing.assert_array_equal(whole.reset()[:, : whole.local_size], cut.reset())
    actions = np.zeros((whole.num_envs, 5), dtype=np.int64)
    for _ in range(12):
        rows, rewards, dones, infos = whole.step(actions)
        seen, *others, seen_infos = cut.step(actions)
        np.testing.assert_array_equal(rows[:, : whole.local_size], seen)
        np.testing.assert_array_equal(np.array([rewards, dones]), np.array(others))
    assert dones.all()
    for info, seen_info in zip(infos, seen_infos, strict=True):
        np.testing.assert_array_equal(
            info["terminal_observation"][: whole.local_size], seen_info["terminal_observation"]
        )


@pytest.mark.parametrize("name", ["mappo", "ippo", "vdn", "qmix", "iql"])
def test_each_setting_is_an_argument_of_the_learner(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    package = "mappo" if name in ("mappo", "ippo") else "qlearning"
    monkeypatch.setattr(f"uavaou.algorithms.{package}.{name.upper()}", dict)  # "builds" its arguments

    def arguments(config: Any) -> dict[str, Any]:
        given: dict[str, Any] = config.build(None, 0, "cpu")
        given |= given.pop("policy_kwargs")
        return {name: [one(left) for left in (1, 0.5, 0)] if callable(one) else one for name, one in given.items()}

    published = registry.load_config(name, {} if package == "qlearning" else {"entropy": 0.01})
    of_run = {"plan_slots", "map_plan_slots"}  # of what comes before the training
    for field in type(published).model_fields.keys() - AlgorithmConfig.model_fields - of_run:
        value = getattr(published, field)
        other = (*value, 8) if isinstance(value, tuple) else "another" if isinstance(value, str) else 2 * value + 1
        before, after = arguments(published), arguments(published.model_copy(update={field: other}))
        assert len([key for key in before if before[key] != after[key]]) == 1, field


def test_validations_follow_a_smaller_budget() -> None:
    from uavaou.algorithms.registry import load_config

    def validations(**settings: int) -> tuple[int, int]:
        config = load_config("vdn", settings)
        return config.evaluate_every_slots, config.evaluation_missions

    published = 100_000, 32
    assert [validations(), validations(slots=500_000)] == [published, published]
    assert [validations(slots=slots) for slots in (250_000, 60_000, 1)] == [(50_000, 16), (12_000, 8), (1, 8)]
    assert validations(slots=1, evaluate_every_slots=7) == (7, 32)
    assert validations(slots=1, evaluation_missions=4) == (1, 4)


def test_a_run_whose_critic_read_both_parts_is_to_be_trained_again() -> None:
    fields = registry.load_config("mappo-paper").model_dump() | {"critic_input": "both"}
    with pytest.raises(InputError, match=r"^run: algorithm: critic_input = 'both': .*: train again$"):
        registry.config_from_dict(fields, Path("run"))
