"""A study of an algorithm of one's own, from the command line: the processes of its jobs load the plugin first."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from uavaou.experiments.results import read_study

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "plain_ppo.py"
STUDY = """
description: A plain PPO
slots: 96
seeds: 1
scenarios: [tiny]
variants:
  plain: {algorithm: plain-ppo, set: {missions: 4, rollout_slots: 24, minibatches: 2, evaluation_missions: 2}}
planners: [stay]
episodes: 2
"""


@pytest.mark.slow
@pytest.mark.parametrize(("plugin", "engine"), [("own_ppo", "local"), ("own_ppo.py", "ray")])
def test_a_study_trains_what_a_plugin_registers(plugin: str, engine: str, tmp_path: Path) -> None:
    if importlib.util.find_spec("ray") is None and engine == "ray":
        pytest.skip("ray is not installed")
    shutil.copy(EXAMPLE, tmp_path / "own_ppo.py")
    (tmp_path / "mine.yaml").write_text(STUDY)
    command = ["--plugin", plugin, "study", "run", "mine.yaml", "--jobs", "1", "--engine", engine, "--quiet"]
    surroundings = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    ran = subprocess.run(
        [sys.executable, "-m", "uavaou", *command], cwd=tmp_path, env=surroundings, capture_output=True, text=True
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    results = read_study(tmp_path / "results" / "studies" / "mine")
    assert len(results.trainings("plain", "tiny")) == 1
