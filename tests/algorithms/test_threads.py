"""A training gives the same weights, bit by bit, with any number of threads."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

from tests.algorithms.small_mappo import small_model, weights
from uavaou import IPPO, Family, Scenario, flatten
from uavaou.algorithms.fast import update
from uavaou.algorithms.fast.update import FastUpdate
from uavaou.algorithms.mappo.mappo import LossStatistics
from uavaou.algorithms.registry import load_config, make_model
from uavaou.threads import Tasks, use_threads

SMALL: dict[str, dict[str, Any]] = {
    "ppo": {"missions": 4, "rollout_slots": 30, "batch_rows": 120},
    "q": {"missions": 4, "learning_starts": 60, "batch_slots": 64, "replay_slots": 1000, "slots_per_update": 16},
}


def trained(algorithm: str, family: str | None = None, **settings: Any) -> BaseAlgorithm:
    """Two rollouts and updates of a published learner with small ones, or a Q-learner's gradient steps meanwhile."""
    small = SMALL["ppo" if algorithm in ("mappo", "ippo") else "q"]
    config = load_config(algorithm, small | settings)
    scenario, worlds = (Family.load(family), 2) if family else (Scenario.load("quickstart"), 1)
    env = flatten(scenario, config.missions, rows=config.rows, worlds=worlds)
    return make_model(config, env, seed=0, device="cpu").learn(2 * 30 * env.num_envs)


LEARNERS: dict[str, Callable[[], BaseAlgorithm]] = {
    "mappo": lambda: trained("mappo"),
    "ippo": lambda: trained("ippo"),
    "mappo, set": lambda: trained("mappo", network="set"),
    "mappo, family": lambda: trained("mappo", "any", network="set"),
    "vdn": lambda: trained("vdn"),
    "qmix": lambda: trained("qmix"),
    "iql": lambda: trained("iql"),
    "vdn, set": lambda: trained("vdn", network="set"),
    "qmix, set": lambda: trained("qmix", network="set"),
}


@pytest.mark.parametrize("name", list(LEARNERS))
def test_weights_do_not_depend_on_the_number_of_threads(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(update, "ROWS", 40)  # of a shard: several in each minibatch
    monkeypatch.setattr(update, "AUTOGRAD_ROWS", 40)
    of_one, of_several = [
        weights(LEARNERS[name]()).numpy().tobytes() for number in (1, 3) for _ in [use_threads(number)]
    ]
    assert of_several == of_one


@pytest.mark.parametrize("name", ["mappo", "mappo, set", "qmix"])
def test_two_trainings_in_threads_of_one_process_end_and_do_not_disturb_each_other(name: str) -> None:
    use_threads(2)
    model = small_model(IPPO, n_steps=30)
    before = weights(model)
    with ThreadPoolExecutor(2) as pool:
        other, beside = pool.submit(LEARNERS[name]), pool.submit(model.learn, 2 * 30 * 8)
        other.result(timeout=100)
        after = weights(beside.result(timeout=100))
    assert after.isfinite().all()
    assert not th.equal(after, before)


class Bodies(BaseCallback):
    """Puts a module behind both bodies before the training."""

    def __init__(self, module: nn.Module) -> None:
        super().__init__()
        self._module = module

    def _on_step(self) -> bool:
        return True

    def _on_training_start(self) -> None:
        for body in (self.model.policy.actor_body, self.model.policy.critic_body):
            body.append(deepcopy(self._module))


@pytest.mark.parametrize(
    ("module", "divisible"),
    [(nn.LayerNorm(16), True), (nn.BatchNorm1d(16), False), (nn.Dropout(), False)],
    ids=["layer norm", "batch norm", "dropout"],
)
def test_a_network_is_divided_where_it_keeps_rows_apart(
    module: nn.Module, divisible: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(update, "AUTOGRAD_ROWS", 40)
    alone = []
    init = Tasks.__init__
    monkeypatch.setattr(Tasks, "__init__", lambda self, **how: [alone.append(how["alone"]), init(self, **how)][1])

    def weights_with(threads: int) -> bytes:
        use_threads(threads)
        model = small_model(n_steps=30, batch_size=120, n_epochs=2, policy_kwargs={"net_arch": [16]})
        model.learn(2 * 30 * 8, callback=Bodies(module))
        fast = FastUpdate(model, 0.2, 0.0, 1.0)
        assert fast.divisible == divisible
        assert fast.pieces((np.arange(120), np.arange(60))) == ([3, 1] if divisible else [1, 1])
        return bytes(weights(model).numpy().tobytes())

    assert weights_with(1) == weights_with(2)
    assert alone[-1] != divisible


def test_a_module_that_is_replaced_between_updates_is_used() -> None:
    class Replace(BaseCallback):
        def _on_rollout_end(self) -> None:
            if self.num_timesteps > 30 * 8:
                self.model.policy.actor_body[1] = nn.ReLU()

        def _on_step(self) -> bool:
            return True

    def trained_with(callback: BaseCallback | None) -> th.Tensor:
        model = small_model(n_steps=30, batch_size=120, n_epochs=2, policy_kwargs={"activation": "tanh"})
        return weights(model.learn(2 * 30 * 8, callback=callback))

    assert not np.allclose(trained_with(Replace()), trained_with(None))


@pytest.mark.parametrize("critic_input", ["global", "local"])
def test_the_gradient_with_two_threads_is_that_of_the_rollout_just_collected(
    critic_input: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each gradient of a training is compared with autograd's of the loss on the buffer, as it then is."""
    use_threads(2)
    model = small_model(n_steps=30, batch_size=120, n_epochs=1, policy_kwargs={"critic_input": critic_input})
    gradient_and_step, compared_batches = model._gradient_and_step, []

    def compared(clip_range: float, mean: float, std: float) -> Any:
        gradient, step = gradient_and_step(clip_range, mean, std)

        def both(indices: Any) -> LossStatistics:
            model.backward(model.loss(model.rollout_buffer.batch(indices), clip_range, mean, std))
            expected = [parameter.grad for parameter in model.policy.actor_and_critic_parameters()]
            statistics = gradient(indices)
            found = [parameter.grad for parameter in model.policy.actor_and_critic_parameters()]
            for one, other in zip(found, expected, strict=True):
                th.testing.assert_close(one, other, rtol=2e-3, atol=2e-5)
            compared_batches.append(statistics)
            return statistics

        return both, step

    monkeypatch.setattr(model, "_gradient_and_step", compared)
    model.learn(4 * 30 * 8)
    assert len(compared_batches) == 4 * 2
