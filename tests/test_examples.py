"""The examples do what they say."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer

from uavaou.algorithms.mappo import CentralizedValuePolicy

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.mark.slow
def test_stock_ppo_trains_the_centralised_policy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    example = import_module("stock_ppo")
    learners = []
    monkeypatch.setattr(example, "PPO", lambda *args, **kwargs: learners.append(PPO(*args, **kwargs)) or learners[0])
    before, after = example.train(slots=16_000)
    assert after < before / 10
    (model,) = learners
    assert type(model) is PPO
    assert type(model.rollout_buffer) is RolloutBuffer
    assert type(model.policy) is CentralizedValuePolicy


@pytest.mark.slow
def test_vdn_learns_the_switchboards() -> None:
    ended = subprocess.run(
        [sys.executable, str(EXAMPLES / "switchboards.py")], capture_output=True, text=True, check=True
    )
    before, after = (float(line.split()[1]) for line in ended.stdout.splitlines())
    assert before < 0.5
    assert after > 0.95
