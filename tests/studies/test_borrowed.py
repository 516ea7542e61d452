"""What a study takes over from other studies: the same trainings and planners under its own names, and durations."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.studies.tiny_study import SET, TINY, Inline, run_inline
from uavaou.studies.borrowed import borrow, expected_cpu_s
from uavaou.studies.folder import StudyFolder
from uavaou.studies.results import read_begun, read_study
from uavaou.studies.study import Study


def another(place: Path, old: str = "", new: str = "") -> Study:
    """The same trainings and planners under other names."""
    text = TINY.replace("  mappo:", "  shared critic:").replace("[tiny]", "[{scenario: tiny, name: small}]")
    text = text.replace("shared critic: {set", "shared critic: {algorithm: mappo, set").replace(old, new)
    (place / "another.yaml").write_text(text)
    return Study.load(place / "another.yaml")


def test_what_another_study_has_is_not_done_again(copied: tuple[Study, Path]) -> None:
    _, out = copied
    engine = Inline()
    ended = run_inline(another(out.parent), out, engine)
    assert (engine.done, ended.done, ended.total) == ([], 7, 7)
    own, others = read_study(out / "studies" / "another"), read_study(out / "studies" / "mine")
    assert list(own.algorithms) == ["shared critic", "own critic"]
    for name, seed in (("mappo", 1), ("greedy", None)):
        mine = others.table("missions", name, "tiny", seed)["mean_aou_slots"]
        found = own.table("missions", name.replace("mappo", "shared critic"), "small", seed)["mean_aou_slots"]
        assert mine.tolist() == found.tolist()


@pytest.mark.parametrize(
    ("old", "new", "left"),
    [
        ("episodes: 3", "episodes: 4", {"own critic", "shared critic", "greedy", "anneal", "bound"}),
        ("slots: 192", "slots: 240", {"own critic", "shared critic"}),
        ("seconds: 0.2", "seconds: 0.3", {"anneal"}),
    ],
)
def test_what_differs_is_not_taken_over(copied: tuple[Study, Path], old: str, new: str, left: set[str]) -> None:
    _, out = copied
    study = another(out.parent, old, new)
    results = read_begun(StudyFolder.of(out, study.name))
    borrow(results, study, out)
    assert {key.variant for key in study.work_order() if key not in results.parts} == left


def test_the_time_is_that_of_trainings_of_the_same_kind(copied: tuple[Study, Path]) -> None:
    mine, out = copied
    known = read_study(out / "studies" / "mine")
    rate = sum(float(known.cell(run.key, "cpu_s")) / float(known.cell(run.key, "slots")) for run in mine.runs()) / 4
    study = another(out.parent, "slots: 192", "slots: 240")
    nothing = read_begun(StudyFolder.of(out, study.name))
    cpu_s, unknown = expected_cpu_s(study, nothing, out)
    assert cpu_s == pytest.approx(4 * 240 * rate)
    assert unknown == []
    wider = another(out.parent, SET, SET.replace("[8]", "[8, 8]"))
    assert expected_cpu_s(wider, nothing, out)[1] == ["mappo set 8 8", "ippo mlp 8 8"]
    assert expected_cpu_s(study, nothing, out / "nowhere") == (0.0, [])
