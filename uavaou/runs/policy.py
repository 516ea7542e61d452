"""The policy of a run, with the interface of planners; it reads local observations alone."""

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm

from uavaou.algorithms.io.save_load import load_policy_arrays
from uavaou.algorithms.io.tensor_file import POLICY, ArrayFile
from uavaou.algorithms.registry import make_model
from uavaou.envs.flatten import flatten
from uavaou.envs.spaces import action_masks, split_actions
from uavaou.errors import InputError
from uavaou.runs.checkpoint_header import open_policy
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.pull_plan import PlanOfEachMap, plan_of
from uavaou.scenario import Scenario
from uavaou.world import World
from uavaou.world.knowledge import Knowledge, check_within, level, observed
from uavaou.world.pull import Plans
from uavaou.world.views import MOVES, RowLayout, Rows, RowViews

Actions = tuple[NDArray[np.int64], NDArray[np.bool_] | None]
Fit = Callable[[Scenario], tuple[BaseAlgorithm, RowViews]]
_STREAM = 3  # spawn key of the policies' random streams, apart from the layouts' (1) and the planners' (2)


@dataclass
class TrainedPolicy:
    """A learner's policy in the planners' interface; it flies every scenario that its weights fit."""

    model: BaseAlgorithm
    views: RowViews  # what its UAVs see, of the scenario flown
    action: str = "greedy"  # the likeliest; or "sample"
    digest: str = ""  # SHA-256 of the weights in the checkpoint that they were loaded from; empty where none was
    fit: Fit | None = None  # the same weights for another scenario; None: for that of ``views`` alone
    renews_parts: bool = True  # whether its UAVs make the plan of parts anew when others are lost, or down for a swap
    _rngs: list[np.random.Generator] = field(default_factory=list)

    @property
    def knows(self) -> Knowledge:
        """What its UAVs read in flight."""
        return observed(self.views.observation)

    @property
    def plans_maps(self) -> bool:
        """Whether it plans for each map before its first flight."""
        return isinstance(getattr(self.views, "plan", None), PlanOfEachMap)

    def reset(self, world: World, seed: int) -> None:
        """Start missions; mission j samples from a stream seeded with ``seed + j``.

        Raises:
            InputError: the policy does not fit the scenario of ``world``.
        """
        if world.scenario != self.views.scenario:
            assert self.fit is not None
            self.model, self.views = self.fit(world.scenario)
        self.views.renews_parts = self.renews_parts
        self.views.takes_turns = self.renews_parts and self.plans_maps
        lanes = range(world.missions)
        self._rngs = [np.random.default_rng(np.random.SeedSequence(seed + j, spawn_key=(_STREAM,))) for j in lanes]

    def act(self, world: World) -> Actions:
        """Moves (N, U) and selections (N, U, I), None for every device in range."""
        return act_together([self], [world])[0]

    def local_rows(self, world: World) -> Rows:
        """What the UAVs see, (N * U, local); rows of padding are left out."""
        local = self.views.local(world)[:, : world.scenario.uavs]
        return local.reshape(-1, local.shape[-1])

    def uniforms(self, world: World) -> Rows:
        """The next uniform numbers of each UAV, (N * U, 5 + I), of which devices of padding take none."""
        layout, scenario = self.views.layout, world.scenario
        width = MOVES + (scenario.devices if layout.selects else 0)
        drawn = np.stack([rng.random((scenario.uavs, width), dtype=np.float32) for rng in self._rngs])  # (N, U, 5 + I)
        padding = layout.devices - scenario.devices if layout.selects else 0
        return np.pad(drawn.reshape(-1, width), ((0, 0), (0, padding)))

    def actions(self, chosen: NDArray[np.int64], world: World) -> Actions:
        """The ``chosen`` actions (N * U, 1 + I) or (N * U,) as :meth:`act` returns them."""
        moves, selections = split_actions(chosen, world.missions, world.scenario.uavs, self.views.layout.selects)
        return moves, selections if selections is None else selections[:, :, : world.scenario.devices]


def act_together(policies: Sequence[TrainedPolicy], worlds: Sequence[World]) -> list[Actions]:
    """What the policies of one model do in the Worlds, one each, in one evaluation of the network."""
    flights = list(zip(policies, worlds, strict=True))
    model, greedy = policies[0].model, policies[0].action == "greedy"
    local = np.concatenate([policy.local_rows(world) for policy, world in flights])
    drawn = None if greedy else np.concatenate([policy.uniforms(world) for policy, world in flights])
    uniforms = None if drawn is None else th.from_numpy(drawn).to(model.device)
    layout = policies[0].views.layout
    chosen = _act(model, th.from_numpy(local).to(model.device), uniforms, layout).cpu().numpy()
    ends = np.cumsum([world.missions * world.scenario.uavs for world in worlds])
    parts = np.split(chosen, ends[:-1])
    return [policy.actions(part, world) for part, (policy, world) in zip(parts, flights, strict=True)]


@th.no_grad()
def _act(model: BaseAlgorithm, local: th.Tensor, uniforms: th.Tensor | None, layout: RowLayout) -> th.Tensor:
    """Actions (B, 1 + I) or (B,) of a learner for ``local`` (B, local): the likeliest, or drawn from ``uniforms``.

    ``policy.act`` where there is one. Any other SB3 policy reads ``local`` as its observation, with the masks in it
    where it takes them (MaskablePPO); one without a distribution (DQN) has its greedy action alone.
    """
    policy: Any = model.policy
    if hasattr(policy, "act"):
        chosen: th.Tensor = policy.act(local, uniforms)
        return chosen
    rows, masked = local.cpu().numpy(), "action_masks" in inspect.signature(model.predict).parameters
    masks: dict[str, Any] = {"action_masks": action_masks(rows, layout)} if masked else {}
    if uniforms is None or not hasattr(policy, "get_distribution"):
        return th.from_numpy(model.predict(rows, deterministic=True, **masks)[0])
    drawn_from = policy.get_distribution(local, **masks)
    categories: Any = drawn_from.distributions if masked and layout.selects else drawn_from.distribution
    if not layout.selects:
        return _draw(categories.probs, uniforms[:, 0])
    columns = [0, *range(MOVES, uniforms.shape[1])]  # one uniform for the move, one for each device
    drawn = [_draw(part.probs, uniforms[:, k]) for part, k in zip(categories, columns, strict=True)]
    return th.stack(drawn, dim=1)


def _draw(probabilities: th.Tensor, uniforms: th.Tensor) -> th.Tensor:
    """Categories (B,) of ``probabilities`` (B, C), by inversion of their distribution function at ``uniforms`` (B,)."""
    ends = probabilities.cumsum(dim=1)  # (B, C)
    return (uniforms[:, None] >= ends[:, :-1]).sum(dim=1)


def load_run(
    path: RunFolder | Path | str,
    scenario: Scenario | Path | str | None = None,
    action: str | None = None,
    knows: str = "everything",
) -> TrainedPolicy:
    """Load the best policy of a run. It flies every scenario that it fits, and refuses others at ``reset``.

    Args:
        path: the run's folder, or the name of a released policy.
        scenario: to be fitted to at once, so that a misfit is refused here: a name, the path of a YAML file, or the
            scenario itself; None for the one trained on.
        action: ``greedy`` or ``sample``; None for the one that the best checkpoint was chosen by.
        knows: the most that it may read in flight. One that was trained on ``mixed`` observations flies by ``local`` or
            ``shared`` ones.

    Raises:
        InputError: the folder is no run, holds no checkpoint, was trained on another shape, or needs to know more.

    Examples:
        >>> from uavaou import evaluate, load_run
        >>> policy = load_run("first-run")
        >>> evaluate(policy, "quickstart", episodes=2).violations["bounds"]
        0
    """
    folder = RunFolder.at(path)
    config = folder.read_config()
    checkpoint, progress = open_policy(folder)  # opened once: a training at work may put another in its place
    seen = level(config.algorithm.observation, knows != "local")
    check_within(str(path), observed(seen), knows)
    fit = partial(_fit, folder, config, checkpoint, plan_of(config, folder, in_flight=True), seen)
    model, views = fit(config.scenario if scenario is None else Scenario.load(scenario))
    return TrainedPolicy(model, views, action or progress.best_action, checkpoint.digest(POLICY), fit)


def _fit(
    folder: RunFolder, config: RunConfig, checkpoint: ArrayFile, plan: Plans | None, seen: str, scenario: Scenario
) -> tuple[BaseAlgorithm, RowViews]:
    """The learner of a run for ``scenario``, with the weights of the checkpoint, and what its UAVs see there."""
    config.check_fits(scenario, str(folder))
    algorithm = config.algorithm
    env = flatten(scenario, 1, observation=seen, collection=algorithm.collection, rows=algorithm.rows, plan=plan)
    env.maps_vary = config.maps_vary  # in its training
    checkpoint.check_holds(getattr(algorithm, "hidden", ()))
    try:
        model = make_model(algorithm, env, config.seed, device="cpu")
    except MemoryError as error:
        raise InputError(f"{folder.config}: states a learner that does not fit the memory") from error
    load_policy_arrays(checkpoint, model)
    model.policy.set_training_mode(False)
    return model, env.views
