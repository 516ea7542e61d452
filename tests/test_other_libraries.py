"""The programs of docs/own-algorithm.md for other libraries run, each where its library is installed."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.documents import ROOT, blocks
from uavaou import RunConfig, Scenario, World, load_run, train
from uavaou.algorithms import registry

PAGE = ROOT / "docs" / "own-algorithm.md"


def program(library: str, needs: str = "") -> str:
    """The page's program whose first import is ``library``; skips where it, or what it ``needs``, is not installed."""
    if find_spec(needs or library) is None:
        pytest.skip(f"{needs or library} is not installed")
    (code,) = [code for code in blocks(PAGE, "python") if code.startswith(f"from {library}")]
    return code


@pytest.mark.parametrize("collection", ["select", "auto"])
@pytest.mark.parametrize("action", ["greedy", "sample"])
def test_maskable_ppo_flies_with_the_masks_that_it_learned_with(
    action: str, collection: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = program("sb3_contrib")
    monkeypatch.setattr(registry, "_ALGORITHMS", dict(registry._ALGORITHMS))
    exec(code, {})
    budget: dict[str, Any] = {"slots": 96, "missions": 4, "rollout_slots": 12, "evaluation_missions": 1}
    train(RunConfig.load("maskable-ppo", "tiny", collection=collection, **budget), tmp_path / "run")
    policy, world = load_run(tmp_path / "run", action=action), World(Scenario.load("tiny"), missions=16, seed=3)
    policy.reset(world, 3)
    while not world.done:
        moves, selections = policy.act(world)
        assert np.take_along_axis(world.allowed_moves, moves[..., None], axis=2).all()
        assert selections is None or not (selections & ~world.in_range).any()
        world.step(moves, selections)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("library", "needs"), [("tensordict", "torchrl"), ("ray.rllib", "tree"), ("benchmarl", "")]
)  # ray alone lacks dm-tree
def test_a_program_for_another_library_ends_with_the_return_of_missions(
    library: str, needs: str, tmp_path: Path
) -> None:
    ran = subprocess.run(
        [sys.executable, "-c", program(library, needs)], cwd=tmp_path, capture_output=True, text=True, timeout=500
    )
    assert ran.returncode == 0, ran.stderr
    assert float(ran.stdout.splitlines()[-1]) < 0  # s
