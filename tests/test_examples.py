"""The examples, the notebook and the programs for other libraries run, and do what is said of them."""

import json
import re
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer

from tests.documents import ROOT, blocks
from uavaou import RunConfig, Scenario, World, load_run, train
from uavaou.algorithms import registry
from uavaou.algorithms.mappo import CentralizedValuePolicy
from uavaou.evaluation.flights import Flights

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
    words = [sys.executable, str(EXAMPLES / "switchboards.py")]
    ended = subprocess.run(words, capture_output=True, text=True, check=True)
    before, after = (float(line.split()[1]) for line in ended.stdout.splitlines())
    assert before < 0.5
    assert after > 0.95


PAGE = ROOT / "docs" / "how-to" / "extend.md"


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


LESS = {"SLOTS, EPISODES = 100_000, 100": "SLOTS, EPISODES = 40_000, 20", "/fly --quiet": "/fly --seconds 3 --quiet"}
CELLS = json.loads((ROOT / "examples" / "tour.ipynb").read_text(encoding="utf-8"))["cells"]


def words(text: str) -> list[str]:
    """All but the numbers, which depend on the processor, and the lines, which depend on the terminal."""
    return re.findall(r"[^\W\d]+", text)


def printed(cell: dict[str, Any]) -> str:
    """What the notebook shows below a cell."""
    return "".join(line for output in cell["outputs"] for line in output.get("text", []))


@pytest.mark.slow
def test_the_tour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    matplotlib.use("agg")
    names: dict[str, Any] = {}
    trained = False
    for cell in CELLS:
        source = "".join(cell["source"])
        for asked, less in LESS.items():
            source = source.replace(asked, less)
        if cell["cell_type"] == "code":
            exec(compile(source, "tour.ipynb", "exec"), names)
            out, shown = capsys.readouterr().out, printed(cell)
            trained = trained or "train" in source
            rehearsed = "Served: " in shown  # what is served depends on the machine's speed
            assert ("Served: " in out) == rehearsed
            assert trained or rehearsed or words(out) == words(shown)
            assert ("0 errors" in out) == ("audit" in source)
    assert all((tmp_path / "tour" / name).is_file() for name in ("mission.html", "drone/policy.onnx"))
    ages = Flights.read(Path(names["run"])).flights.groupby("policy")["mean_aou_slots"]
    assert ages.count()["mappo"] == names["EPISODES"]
    own, any_map, planner = (ages.mean()[name] for name in ("mappo", "any-map", "best-first"))
    assert own < any_map < planner
