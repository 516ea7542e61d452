"""Trainings that are killed, at any moment and again and again, end as the one that was never touched."""

import json
import os
import random
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from safetensors.numpy import load_file

from tests.command_line import forked, start_command
from tests.runs.stopped_runs import assert_ends_as
from uavaou import RunConfig, Scenario, train
from uavaou.algorithms.registry import load_config
from uavaou.runs.folder import RunFolder
from uavaou.threads import use_threads

KILLS = 4  # at random; tests/runs/test_faults.py kills at every write
ON_POLICY = {"rollout_slots": 25, "batch_rows": 100, "epochs": 4, "plan_slots": 500_000}
OFF_POLICY = {"replay_slots": 600, "learning_starts": 200, "batch_slots": 16, "slots_per_update": 20}
SMALL = {"missions": 4, "evaluate_every_slots": 400, "evaluation_missions": 2, "hidden": [16]}


def configuration(algorithm: str, slots: int = 900, **changes: Any) -> RunConfig:
    own = OFF_POLICY if algorithm in ("vdn", "qmix", "iql") else ON_POLICY
    settings = load_config(algorithm, SMALL | own | {"slots": slots} | changes)
    return RunConfig(Scenario.load("quickstart").replace(slots=40), settings, seed=0)


def play(config: RunConfig, path: Path, threads: int | None = None) -> None:
    """Train, or go on, with a checkpoint after every update: as many moments as possible to be killed in one."""
    use_threads(threads)
    train(config, RunFolder(path), resume=True, checkpoint_every_s=0)


def start(config: RunConfig, path: Path, threads: int | None = None) -> Any:
    process = forked.Process(target=play, args=(config, path, threads))
    process.start()
    return process


def kill_until_done(config: RunConfig, path: Path, seed: int, longest_s: float, most: int) -> int:
    """Kill the training after random times, so often at most, until it gets to its end; returns how often."""
    rng, kills = random.Random(seed), 0
    while True:
        process = start(config, path)
        process.join(rng.uniform(0, longest_s) if kills < most else None)
        if process.exitcode is not None:
            assert process.exitcode == 0
            return kills
        process.kill()
        process.join()
        kills += 1


def assert_the_same(one: RunFolder, other: RunFolder) -> None:
    assert_ends_as(other, one)
    assert load_file(one.previous).keys() == load_file(other.previous).keys()
    metas = [json.loads(run.meta.read_text()) for run in (one, other)]
    assert metas[0]["best_score"] == metas[1]["best_score"]
    assert metas[1]["finished"]


@pytest.mark.slow
@pytest.mark.parametrize(("algorithm", "threads"), [("mappo", 2), ("qmix", None)])
def test_a_training_killed_at_random_times_is_the_one_never_touched(
    algorithm: str, threads: int | None, tmp_path: Path
) -> None:
    config = configuration(algorithm)
    whole = RunFolder(tmp_path / "whole")
    start(configuration(algorithm, slots=100), tmp_path / "first").join()  # starts the server of processes too
    began = time.monotonic()
    untouched = start(config, whole.path, threads)  # those that are killed have all
    untouched.join()
    assert untouched.exitcode == 0
    length = time.monotonic() - began
    kills = runs = 0
    while kills < KILLS:
        folder = RunFolder(tmp_path / f"killed-{runs}")
        kills += kill_until_done(config, folder.path, seed=runs, longest_s=length / 2, most=KILLS - kills)
        assert_the_same(whole, folder)
        runs += 1


TRAIN = (
    "train --scenario quickstart --slots 200000 --quiet --set algorithm.missions=8 --set algorithm.rollout_slots=50 "
    "--set algorithm.batch_rows=400 --set algorithm.evaluation_missions=2 --set algorithm.plan_slots=10000"
)


def wait_for_missions(out: Path, missions: int = 7) -> RunFolder:
    """Wait until missions have ended."""
    deadline = time.monotonic() + 300
    while time.monotonic() < deadline:
        for episodes in out.glob("*/*/seed-0/episodes.csv"):
            if episodes.read_text().count("\n") > missions:
                return RunFolder(episodes.parent)
        time.sleep(0.05)
    raise AssertionError("the training did not begin")


def ended(process: Any) -> int | None:
    process.join(120)
    code: int | None = process.exitcode
    return code


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code", "processes"), [(signal.SIGINT, 130, 2), (signal.SIGTERM, 143, 1)])
def test_a_signal_is_answered_with_a_checkpoint(
    number: signal.Signals, code: int, processes: int, tmp_path: Path
) -> None:
    process = start_command(f"{TRAIN} --set algorithm.processes={processes} --out {tmp_path}", tmp_path / "stderr")
    folder = wait_for_missions(tmp_path)
    os.killpg(process.pid, number)  # as a terminal does: to the workers too
    assert ended(process) == code
    said = (tmp_path / "stderr").read_text()
    assert said.count("\n") == 1, said
    again = said.split("to go on: uavaou ")[1]
    assert again.endswith("--resume\n")
    slots = json.loads(folder.meta.read_text())["slots"]
    assert f"interrupted after {slots:,} slots" in said
    process = start_command(again, tmp_path / "stderr")
    wait_for_missions(tmp_path, slots // 60 + 7)
    os.killpg(process.pid, number)
    assert ended(process) == code
    assert json.loads(folder.meta.read_text())["slots"] > slots


@pytest.mark.slow
def test_a_second_signal_leaves_at_once_and_loses_nothing(tmp_path: Path) -> None:
    # Minutes to an update.
    process = start_command(f"{TRAIN.replace('=50', '=20000')} --out {tmp_path}", tmp_path / "stderr")
    folder = wait_for_missions(tmp_path)
    os.killpg(process.pid, signal.SIGINT)
    time.sleep(0.3)
    assert process.is_alive()
    rows = folder.episodes.read_text().count("\n")
    began = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    assert ended(process) == 130
    assert time.monotonic() - began < 20
    assert (tmp_path / "stderr").read_text().count("\n") == 1
    assert folder.episodes.read_text().count("\n") >= rows


@pytest.mark.slow
def test_a_second_writer_is_refused_and_a_dead_one_is_not(tmp_path: Path) -> None:
    first = start_command(f"{TRAIN} --out {tmp_path} --resume", tmp_path / "first")
    folder = wait_for_missions(tmp_path)
    assert ended(start_command(f"{TRAIN} --out {tmp_path} --resume", tmp_path / "second")) == 2
    said = (tmp_path / "second").read_text()
    assert f"is being written by process {first.pid}" in said
    assert said.count("\n") == 1
    assert first.is_alive()
    first.kill()
    first.join()
    folder.episodes.unlink()
    third = start_command(f"{TRAIN} --out {tmp_path} --resume", tmp_path / "third")
    wait_for_missions(tmp_path)
    os.killpg(third.pid, signal.SIGINT)
    assert ended(third) == 130
