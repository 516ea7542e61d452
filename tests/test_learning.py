"""Every learner learns: trained by the command, with all threads, it is as fresh as a planner on the same missions.

A mutation breaks learning in a way that no exception tells of. Each turns some of these trainings red:
``pytest tests/test_learning.py --exhaustive``.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from uavaou.algorithms.fast.update import FastUpdate
from uavaou.algorithms.mappo.buffer import SlotRolloutBuffer
from uavaou.algorithms.qlearning.policy import JointQPolicy
from uavaou.algorithms.qlearning.replay import JointReplay
from uavaou.runs.folder import RunFolder
from uavaou.runs.validation import planner_score
from uavaou.threads import available_threads
from uavaou_cli.main import main

pytestmark = pytest.mark.slow

PLANNER = "best-first"


class Gate(NamedTuple):
    """A training of ``quickstart``."""

    slots: int
    most: float  # mean AoU of the best validation, over the planner's
    settings: dict[str, Any]


# Many updates in few slots. Of three or four seeds, the worst training has at most 0.65 of what its gate allows.
Q = {"missions": 16, "slots_per_update": 32, "batch_slots": 128, "learning_starts": 2000, "collection": "auto"}
Q |= {"gamma": 0.95, "target_fraction": 0.02}
SET = {"missions": 8, "rollout_slots": 100, "batch_rows": 400, "learning_rate": 0.002, "gamma": 0.98}
SET |= {"entropy": 0.005, "final_entropy": 0.1}
FROM_NOTHING = {"pull": 0, "plan_slots": 0, "critic_rollouts": 0, "token_width": 32, "hidden": "[128, 128]"}
FROM_NOTHING |= {"reward": "root"}
GATES = {
    "mappo": Gate(64_000, 1.4, {}),
    "ippo": Gate(48_000, 1.4, {}),
    "vdn": Gate(24_000, 1.4, Q | {"hidden": "[64, 64]", "learning_rate": 0.002, "n_step": 1}),
    "qmix": Gate(24_000, 1.4, Q | {"hidden": "[64, 64]", "learning_rate": 0.001}),
    "mappo set": Gate(32_000, 1.6, SET | FROM_NOTHING),
    "qmix set": Gate(18_000, 3.0, Q | {"learning_rate": 0.002, "n_step": 1}),
}


def trained(name: str, out: Path) -> float:
    """The mean AoU of a gate's training in its best validation, over the planner's on the same missions."""
    gate, (algorithm, *network) = GATES[name], name.split()
    settings = gate.settings | {"network": network[0] if network else "mlp"}
    words = [word for key, value in settings.items() for word in ("--set", f"algorithm.{key}={value}")]
    words += ["--algorithm", algorithm, "--slots", str(gate.slots), "--out", str(out), "--quiet"]
    assert main(["train", "quickstart", *words]) == 0
    folder = RunFolder(next(out.glob("*/*/seed-0")))
    meta = folder.read_meta()
    assert meta.threads == available_threads()
    return meta.best_score / planner_score(PLANNER, folder.read_config())


@pytest.mark.parametrize("name", list(GATES))
def test_a_short_training_is_as_fresh_as_a_planner(name: str, tmp_path: Path) -> None:
    assert trained(name, tmp_path) < GATES[name].most


def test_the_default_is_below_the_rule_on_the_paper_s_map_at_once(tmp_path: Path) -> None:
    assert main(["train", "--slots", "24000", "--out", str(tmp_path), "--quiet"]) == 0  # some 20 s on two cores
    folder = RunFolder(next(tmp_path.glob("*/*/seed-0")))
    best, config = folder.read_meta().best_score, folder.read_config()
    assert best / config.scenario.slot_length_s < 38.5
    assert best < 0.97 * planner_score("local-greedy-parts", config)


def stale_critic_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """The critic learns on the rows of the first rollout for ever, as it once did with two threads."""
    first: dict[int, Any] = {}
    init = FastUpdate.__init__

    def keep_first(update: Any, model: Any, *numbers: Any) -> None:
        init(update, model, *numbers)
        update._critic_rows = first.setdefault(id(model.rollout_buffer), update._critic_rows.clone())

    monkeypatch.setattr(FastUpdate, "__init__", keep_first)


def flipped_advantages(monkeypatch: pytest.MonkeyPatch) -> None:
    compute = SlotRolloutBuffer.compute_returns_and_advantage

    def flip(buffer: Any, *arguments: Any, **named: Any) -> None:
        compute(buffer, *arguments, **named)
        buffer.advantages *= -1

    monkeypatch.setattr(SlotRolloutBuffer, "compute_returns_and_advantage", flip)


def frozen_target(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(JointQPolicy, "update_target", lambda policy, fraction: None)


def flipped_rewards(monkeypatch: pytest.MonkeyPatch) -> None:
    add = JointReplay.add
    monkeypatch.setattr(
        JointReplay, "add", lambda replay, rows, actions, rewards, dones: add(replay, rows, actions, -rewards, dones)
    )


MUTATIONS: dict[Callable[[pytest.MonkeyPatch], None], tuple[str, ...]] = {
    stale_critic_rows: ("mappo",),
    flipped_advantages: ("mappo", "ippo", "mappo set"),
    frozen_target: ("vdn",),
    flipped_rewards: ("vdn", "qmix", "qmix set"),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize(("mutate", "name"), [(mutate, name) for mutate, names in MUTATIONS.items() for name in names])
def test_a_mutation_is_seen(
    mutate: Callable[[pytest.MonkeyPatch], None], name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mutate(monkeypatch)
    assert trained(name, tmp_path) >= GATES[name].most
