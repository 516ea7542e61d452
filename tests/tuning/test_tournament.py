"""A search for several algorithms: its stages, trials of several trainings, and what stands in its tables."""

from __future__ import annotations

import csv
import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.documents import ROOT
from tests.tuning.small_search import SMALL, a_search, interrupted_after, states
from uavaou import InputError
from uavaou.runs.folder import RunConfig
from uavaou.tuning import trials
from uavaou.tuning.search import SearchFolder, ranked
from uavaou.tuning.tournament import Tournament
from uavaou.tuning.trials import read_trials, work
from uavaou_cli.main import main

PLAN: dict[str, Any] = {
    "scenario": "tiny",
    "arms": {"ippo": {"set": SMALL}, "small": {"algorithm": "mappo", "set": SMALL}},
    "stages": [
        {"trials": 3, "seconds": 1, "layouts": [6]},
        {"top": 2, "seconds": 2, "layouts": [7, 8], "seeds": 2},
    ],
}


def in_this_process(folder: SearchFolder, wanted: int, *_: Any) -> Any:
    work(folder, wanted)
    return read_trials(folder)


def written(path: Path, **changes: Any) -> Path:
    path.write_text(json.dumps(PLAN | changes))
    return path


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_arm_goes_through_the_same_stages(
    tmp_path: Path, played: list[RunConfig], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("warm_up", "affordable_slots"):
        monkeypatch.setattr(trials, name, lambda *_: 1000)
    monkeypatch.setattr(trials, "run_search", in_this_process)
    plan = written(tmp_path / "plan.yaml")
    assert main(shlex.split(f"tune --search '{plan}' --out '{tmp_path}'")) == 0
    rows = rows_of(tmp_path / "plan" / "search.csv")
    assert {(row["arm"], row["stage"]) for row in rows} == {(arm, n) for arm in ("ippo", "small") for n in "12"}
    last = [row for row in rows if (row["arm"], row["stage"]) == ("small", "2")]
    assert [row["trainings"] for row in last] == ["4", "4"]
    finals = played[-8:]
    assert [(config.scenario.layout_seed, config.seed) for config in finals[:4]] == [
        (layout, seed) for seed in range(2) for layout in (7, 8)
    ]
    before = ranked(read_trials(SearchFolder(tmp_path / "plan" / "small" / "stage-1")))[:2]
    after = read_trials(SearchFolder(tmp_path / "plan" / "small" / "stage-2"))
    assert [record.values for record in after] == [record.values for record in before]
    out = capsys.readouterr().out
    assert "2 arms, 2 stages, 22 trainings" in out
    assert "layout 8" in out
    count = len(played)
    assert main(shlex.split(f"tune --search '{plan}' --out '{tmp_path}' --quiet")) == 0  # nothing is left to do
    assert len(played) == count


def test_a_trial_goes_on_after_the_trainings_that_have_ended(
    tmp_path: Path, played: list[RunConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = SearchFolder(tmp_path)
    search = replace(a_search(), layouts=(6, 7), seeds=2)
    folder.claim(search)
    assert folder.read() == search
    with interrupted_after(3, played, monkeypatch):
        work(folder, 1)
    work(folder, 1)
    assert [(config.scenario.layout_seed, config.seed) for config in played] == [(6, 0), (7, 0), (6, 1), (7, 1)]
    assert states(folder) == ["interrupted", "complete"]
    again = read_trials(folder)[1]
    assert again.cpu_s == pytest.approx(4.0)
    assert len(again.trainings) == len({row["seed"] + row["layout_seed"] for row in rows_of(folder.trainings)}) == 4


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"stages": [{"top": 2, "seconds": 1, "layouts": [6]}]}, r"stages\[0\]: expected trials, and not top"),
        ({"stages": [PLAN["stages"][0], PLAN["stages"][0]]}, r"stages\[1\]: expected top, and not trials"),
        ({"stages": [PLAN["stages"][0], PLAN["stages"][1] | {"top": 9}]}, "top = 9: the stage before has 3 settings"),
        ({"arms": {"mapo": None}}, "did you mean 'mappo'"),
        ({"arms": {"iql": None}}, "no search space comes with 'iql'"),
        ({"stages": [{"trials": 3, "seconds": 1}]}, "layouts"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Tournament.load(written(tmp_path / "plan.yaml", **changes))


def test_the_shipped_search_fits_four_hours_of_two_cores_and_chooses_on_layouts_for_choosing() -> None:
    shipped = Tournament.load("local")
    page = (ROOT / "docs/tuning.md").read_text(encoding="utf-8")
    assert f"It has {shipped.trainings} trainings of {shipped.stages[-1].seconds:g} CPU seconds" in page
    assert shipped.cpu_s / 2 < 4 * 3600
    first, last = shipped.stages
    assert sorted(first.layouts + last.layouts) == [6, 7, 8, 9]  # the last stage ranks on layouts that chose nothing
    assert last.seeds == 3
    for config, space in shipped.arms.values():
        assert {"hidden", "masks"} <= space.dimensions.keys(), config.name
    assert "critic_input" in shipped.arms["mappo"][1].dimensions
