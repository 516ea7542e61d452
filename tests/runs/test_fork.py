"""A training that follows another to a slot and then samples by its own seed."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import pytest
from safetensors.numpy import load_file

from tests.runs.stopped_runs import assert_ends_as, every_update, small, stopped_at
from uavaou import InputError
from uavaou.runs.folder import RunFolder, config_folder
from uavaou.runs.start import forked
from uavaou.studies.study import Study


def validations(folder: RunFolder) -> list[tuple[str, str]]:
    """Slots and score of each evaluation."""
    with folder.progress.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["evaluation/mean_aou_sample_s"]]
    return [(row["time/slots"], row["evaluation/mean_aou_sample_s"]) for row in rows]


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["mappo-paper", "qmix"])
def test_it_is_the_other_until_it_parts_and_resumes_exactly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, algorithm: str
) -> None:
    config = replace(small(algorithm, evaluate_every_slots=48), seed=1)
    followed = RunFolder(tmp_path / "followed")
    every_update(config, followed)
    fork = forked(followed, 100, seed=7)
    whole, stopped = config_folder(tmp_path, fork), RunFolder(tmp_path / "stopped")
    assert whole.path.name == "seed-7"
    assert "fork=1-at-100" in whole.path.parent.name
    every_update(fork, whole)
    assert whole.read_config() == fork
    before = [row for row in validations(followed) if int(row[0]) <= 100]
    assert len(before) == 2
    assert validations(whole)[:2] == before
    own, theirs = (load_file(run.last) for run in (whole, followed))
    assert any((own[name] != theirs[name]).any() for name in own if "body" in name)
    with stopped_at(192):  # after the slot at which it parts
        every_update(fork, stopped)
    every_update(fork, stopped, resume=True)
    assert_ends_as(stopped, whole)


@pytest.mark.parametrize(
    ("slots", "seed", "words"),
    [(100, 3, "another seed than that"), (240, 7, "fewer than the budget of 240"), (0, 7, "slots")],
)
def test_a_fork_that_would_never_part_is_refused(tmp_path: Path, slots: int, seed: int, words: str) -> None:
    folder = RunFolder(tmp_path)
    folder.config.write_text(replace(small(), seed=3).to_yaml())
    with pytest.raises((InputError, ValueError), match=words):
        forked(folder, slots, seed)


def test_a_fork_of_a_family_is_refused() -> None:
    with pytest.raises(InputError, match="trains on a family"):
        forked(RunFolder.at("any-map"), 100, 7)


def test_a_variant_of_a_study_may_follow_a_training(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(
        "seeds: [4, 5]\nscenarios: [tiny]\n"
        "variants: {a: {algorithm: mappo, set: {candidates: 1}, fork: {seed: 1, slots: 99}}}\n"
    )
    assert [str(run.config.fork) for run in Study.load(file).runs()] == ["1-at-99"] * 2
    file.write_text(file.read_text().replace("seed: 1", "seed: 4"))
    with pytest.raises(InputError, match=r"variants\.'a': fork: seed = 4"):
        Study.load(file)
