"""Training on ``paper``: speed beside SB3's own PPO on SuperSuit's own stage, the time of each part, and its floor."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch as th
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from benchmarks.measure import Measurement, Stopwatch, exactly, seconds_of, side_by_side
from uavaou import MAPPO, Scenario, flatten
from uavaou.algorithms.config import AlgorithmConfig, MappoConfig
from uavaou.algorithms.fast import update as fast
from uavaou.algorithms.fast.update import ClippedAdam
from uavaou.algorithms.nets.action_head import MoveSelectionDistribution
from uavaou.algorithms.nets.mlp import FullyConnected, Linear
from uavaou.algorithms.registry import load_config, make_model
from uavaou.threads import Tasks, available_threads, use_threads

MISSIONS = 64
# MAPPO's work of one update, the same in every measurement whatever settings are published.
WORK = {"missions": MISSIONS, "rollout_slots": 60, "batch_rows": 750, "epochs": 5, "critic_input": "global"}
ROLLOUTS = 4  # of ours in one measurement, so that one slow moment hardly counts
ALGORITHMS = ("mappo-paper", "vdn", "qmix")
STOCK = "stock SB3 PPO on SuperSuit's stage"
BUSY = "while True: pass"  # the program of a busy process
PRODUCTS = 4000  # of a layer, in one measurement


def training(repeats: int = 3, rollout_slots: int | None = None) -> list[Measurement]:
    """Agent steps a second with updates, for one rollout, minibatch and number of epochs, at two network sizes.

    Then the same beside as many busy processes as there are cores, and what two cores could give at most.
    """
    sizes = ([128, 128], [256, 256])
    free = [measured for hidden in sizes for measured in _training(repeats, rollout_slots, hidden)]
    busy = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(available_threads())]
    try:
        loaded = [measured for hidden in sizes for measured in _loaded(repeats, rollout_slots, hidden)]
    finally:
        for process in busy:
            process.kill()
            process.wait()
    return free + loaded + _cores(repeats)


def _loaded(repeats: int, rollout_slots: int | None, hidden: list[int]) -> list[Measurement]:
    scenario, config = Scenario.load("paper"), _mappo(rollout_slots, hidden=hidden)
    rows = MISSIONS * scenario.uavs * config.rollout_slots
    contestants = {
        _label("mappo-paper", threads): (_learner(_ours(scenario, config), ROLLOUTS * rows, threads), ROLLOUTS * rows)
        for threads in sorted({1, available_threads()})
    }
    beside = f"beside {available_threads()} busy processes"
    return side_by_side(f"training on paper {beside}, networks {hidden[0]}-{hidden[1]}", contestants, repeats)


def _cores(repeats: int) -> list[Measurement]:
    """The products of a layer in one thread, and in each of two at once: what a machine's cores share, nobody gains."""
    rows, layer = th.randn(750, 128), Linear(128, 128)

    @th.no_grad()
    def multiply() -> None:
        for _ in range(PRODUCTS):
            layer(rows)

    def by(number: int) -> Callable[[], None]:
        def work() -> None:
            use_threads(number)
            Tasks(*[multiply] * number).run()
            use_threads(None)

        return work

    th.set_num_threads(1)
    contestants = {f"{number} at once": (by(number), number * PRODUCTS) for number in (1, 2)}
    table = "products of 750 x 128 x 128"
    return [replace(m, unit="products/s") for m in side_by_side(table, contestants, repeats)]


def _label(name: str, threads: int) -> str:
    return f"uavaou {name}, {_threads(threads)}"


def _threads(number: int) -> str:
    return f"{number} thread{'s' if number > 1 else ''}"


def _training(repeats: int, rollout_slots: int | None, hidden: list[int]) -> list[Measurement]:
    scenario, config = Scenario.load("paper"), _mappo(rollout_slots, hidden=hidden)
    rows = MISSIONS * scenario.uavs * config.rollout_slots
    cores = available_threads()
    contestants = {
        f"{STOCK}, {processes} process{'es' if processes > 1 else ''}": (
            _learner(_stock(scenario, config, processes), rows, cores),
            rows,
        )
        for processes in (1, 2)
    }
    for name in ALGORITHMS:
        for threads in sorted({1, cores} if name == "mappo-paper" else {1}):
            model = _ours(scenario, config if name == "mappo-paper" else load_config(name, {"hidden": hidden}))
            contestants[_label(name, threads)] = (_learner(model, ROLLOUTS * rows, threads), ROLLOUTS * rows)
    return side_by_side(f"training on paper, 64 missions, networks {hidden[0]}-{hidden[1]}", contestants, repeats)


def networks(repeats: int = 3, rollout_slots: int | None = None) -> list[Measurement]:
    """Agent steps a second with updates, of the flat network and of the set whose devices pull, for the same work.

    Both are as `mappo-paper` and `mappo` have them, with `auto`, on `paper` and on a map of 10 UAVs and 500 devices.
    """
    corners = [(x, y) for x in (0, 1000, 2000) for y in (0, 1000, 2000)]
    large = Scenario.load("paper").replace(
        area_x_m=2000,
        area_y_m=2000,
        uavs=10,
        devices=500,
        altitudes_m=tuple(range(80, 100, 2)),
        cds_m=(*corners, (500, 500)),
    )
    contestants: dict[str, tuple[str, dict[str, Any]]] = {
        "flat": ("mappo-paper", {"collection": "auto"}),
        "set with pulls": ("mappo", {"critic_rollouts": 0}),
        "set with pulls, part": ("mappo", {"critic_rollouts": 0, "observation": "part"}),
    }
    measured = []
    for title, scenario, missions, epochs in (
        ("paper", Scenario.load("paper"), MISSIONS, WORK["epochs"]),
        ("10 UAVs and 500 devices", large, 16, 1),
    ):
        work: dict[str, Any] = WORK | {"missions": missions, "rollout_slots": rollout_slots or 60, "epochs": epochs}
        rows = ROLLOUTS * missions * scenario.uavs * work["rollout_slots"]
        learners = {
            f"{name}, {_threads(threads)}": (
                _learner(_ours(scenario, load_config(published, work | changes)), rows, threads),
                rows,
            )
            for name, (published, changes) in contestants.items()
            for threads in sorted({1, available_threads()})
        }
        measured += side_by_side(f"networks on {title}, {missions} missions, {epochs} epochs", learners, repeats)
    return measured


def parts(repeats: int = 3, rollout_slots: int | None = None) -> list[Measurement]:
    """The time of each part of MAPPO's training in microseconds an agent step, and the fraction of the floor reached.

    The networks are 128-128.
    """
    scenario, config = Scenario.load("paper"), _mappo(rollout_slots, hidden=[128, 128])
    model = _ours(scenario, config)
    assert isinstance(model, MAPPO)
    rows = MISSIONS * scenario.uavs * config.rollout_slots
    learn = _learner(model, ROLLOUTS * rows, available_threads())
    learn()
    rollout = {
        "rollout: World, rewards, rows": (model.env, "step"),
        "rollout: actor": (model.policy, "action_distribution"),
        "rollout: sampling": (MoveSelectionDistribution, "sample"),
        "rollout: critic and log-probabilities": (model, "evaluate_rollout"),
        "rollout: advantages": (model.rollout_buffer, "compute_returns_and_advantage"),
        "update": (model, "train"),
    }
    update = {
        "update: networks forward": (FullyConnected, "forward"),
        "update: networks backward": (FullyConnected, "backward"),
        "update: loss of the actor": (fast, "clipped_surrogate"),
        "update: loss of the critic": (fast, "squared_error"),
        "update: clipping and Adam": (ClippedAdam, "step"),
    }
    learning, seconds = _split(learn, rollout, repeats, rollouts=ROLLOUTS)
    updating, in_update = _split(model.train, update, repeats)
    seconds["rollout: the rest"] = learning - sum(seconds.values())
    in_update["update: gathering minibatches, the rest"] = updating - sum(in_update.values())
    whole = {"rollout": learning - seconds["update"], **seconds, **in_update, "all": learning}
    table, unit = "MAPPO's time", "us/agent step"
    measured = [exactly(table, part, unit, 1e6 * taken / rows) for part, taken in sorted(whole.items())]
    return measured + _floor(model, config, learning / rows)


def _split(
    work: Callable[[], object], watched: Mapping[str, tuple[object, str]], repeats: int, rollouts: int = 1
) -> tuple[float, dict[str, float]]:
    """Mean seconds of a rollout of ``work``, which has ``rollouts`` of them, and of the functions watched in it."""
    watch = Stopwatch()
    for part, (owner, function) in watched.items():
        watch.watch(part, owner, function)
    started = time.perf_counter()
    for _ in range(repeats):
        work()
    taken = time.perf_counter() - started
    watch.stop()
    each = repeats * rollouts
    return taken / each, {part: seconds / each for part, seconds in watch.seconds.items()}


def _floor(model: MAPPO, config: MappoConfig, seconds_a_step: float) -> list[Measurement]:
    """The floating-point work of an agent step over the machine's float32 product rate, and the fraction reached."""
    policy, uavs = model.policy, model.rollout_buffer.row_layout.uavs
    actor = _work([*policy.actor_body.children(), policy.action_net])
    critic = _work([*policy.critic_body.children(), policy.value_net.linear])
    forward, training = (actor[k] + critic[k] / uavs for k in (0, 1))  # FLOP an agent step
    work = forward + config.epochs * training
    left, right = th.randn(config.batch_rows, 128), th.randn(128, 128)
    product = 2 * config.batch_rows * 128 * 128
    layer = Linear(128, 128)
    with th.no_grad():
        rates = {
            "float32 product, torch.mm": product / seconds_of(lambda: th.mm(left, right), 200),
            "float32 product, oneDNN": product / seconds_of(lambda: layer(left), 200),
        }
    table = "MAPPO's floor"
    shape = f"{config.batch_rows} x 128 x 128"
    measured = [exactly(table, f"{name}, {shape}", "GFLOP/s", rate / 1e9) for name, rate in rates.items()]
    measured.append(exactly(table, "work of an agent step, all epochs", "MFLOP", work / 1e6))
    for name, rate in rates.items():
        measured.append(exactly(table, f"fraction of the floor by {name}", "", work / rate / seconds_a_step))
    return measured


def _work(layers: list[nn.Module]) -> tuple[float, float]:
    """FLOP of a row forward, and forward and backward; the gradient by the observation is not computed."""
    sizes = [layer.in_features * layer.out_features for layer in layers if isinstance(layer, nn.Linear)]
    forward = 2.0 * sum(sizes)
    return forward, 3 * forward - 2 * sizes[0]


def memory(rollouts: int = 6, algorithms: Sequence[str] = ALGORITHMS) -> list[Measurement]:
    """Peak memory of a training process, after its first rollout and update and after some more."""
    measurements = []
    for name in algorithms:
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.memory", name, str(rollouts)],
            cwd=Path(__file__).resolve().parents[1],
            capture_output=True,
            text=True,
            check=True,
        )
        first, last = json.loads(done.stdout)
        for label, value in (("1 rollout", first), (f"{rollouts} rollouts", last)):
            measurements.append(exactly("memory", f"uavaou {name}, peak after {label}", "MiB", value))
    return measurements


def _mappo(rollout_slots: int | None, **changes: Any) -> MappoConfig:
    work = WORK if rollout_slots is None else WORK | {"rollout_slots": rollout_slots}
    config = load_config("mappo-paper", work | changes)
    assert isinstance(config, MappoConfig)
    return config


def _ours(scenario: Scenario, config: AlgorithmConfig) -> BaseAlgorithm:
    missions, collection = config.missions, config.collection
    env = flatten(scenario, missions, observation=config.observation, collection=collection, rows=config.rows)
    return make_model(config, env, seed=0, device="cpu")


def _stock(scenario: Scenario, config: MappoConfig, processes: int) -> BaseAlgorithm:
    hidden = list(config.hidden)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that the last minibatch is smaller
        return PPO(
            "MlpPolicy",
            flatten(scenario, missions=MISSIONS, backend="supersuit", processes=processes),
            n_steps=config.rollout_slots,
            batch_size=config.batch_rows,
            n_epochs=config.epochs,
            policy_kwargs={
                "net_arch": {"pi": hidden, "vf": hidden},
                "activation_fn": nn.Tanh if config.activation == "tanh" else nn.ReLU,
            },
            device="cpu",
        )


def _learner(model: BaseAlgorithm, rows: int, threads: int) -> Callable[[], None]:
    def learn() -> None:
        use_threads(threads)
        th.set_num_threads(threads)  # of SB3's own learner; ours computes with one and divides the work itself
        model.learn(rows, reset_num_timesteps=model.num_timesteps == 0)
        use_threads(None)

    return learn
