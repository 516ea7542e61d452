"""A search for several algorithms: its stages, trials of several trainings, and what stands in its tables."""

from __future__ import annotations

import csv
import json
import shlex
from pathlib import Path
from typing import Any

import pytest

from tests.experiments.small import SMALL, a_search, interrupted_after, read_trials, states, work
from uavaou import InputError
from uavaou.experiments.search import Search, SearchFolder, part, ranked
from uavaou.runs.folder import RunConfig
from uavaou.zoo import zoo_path
from uavaou_cli.main import main

PLAN: dict[str, Any] = {
    "scenario": "tiny",
    "arms": {"ippo": {"set": SMALL}, "small": {"algorithm": "mappo", "set": SMALL}},
    "stages": [
        {"trials": 3, "seconds": 1, "layouts": [6]},
        {"top": 2, "seconds": 2, "layouts": [7, 8], "seeds": 2},
    ],
}


def written(path: Path, **changes: Any) -> Path:
    path.write_text(json.dumps(PLAN | changes))
    return path


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_arm_goes_through_the_same_stages(
    tmp_path: Path, played: list[RunConfig], capsys: pytest.CaptureFixture[str]
) -> None:
    plan = written(tmp_path / "plan.yaml")
    assert main(shlex.split(f"tune --search '{plan}' --out '{tmp_path}'")) == 0
    folder = SearchFolder(tmp_path / "plan")
    rows = rows_of(folder.table)
    assert {(row["arm"], row["stage"]) for row in rows} == {(arm, n) for arm in ("ippo", "small") for n in "12"}
    last = [row for row in rows if (row["arm"], row["stage"]) == ("small", "2")]
    where = [(layout, seed) for seed in range(2) for layout in (7, 8)]
    assert [(int(row["layout_seed"]), int(row["seed"])) for row in last] == where * 2
    assert [(config.scenario.layout_seed, config.seed) for config in played[-8:-4]] == where
    for arm in ("ippo", "small"):
        before, after = (part(read_trials(folder), arm, stage) for stage in (1, 2))
        assert [trial.values for trial in after] == [trial.values for trial in ranked(before)[:2]]
        assert (folder.path / f"best-{arm}.yaml").is_file()
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
    search = a_search(slots=1000, layouts=(6, 7), seeds=2)
    folder.claim(search)
    assert folder.read() == search
    with interrupted_after(3, played, monkeypatch):
        work(folder, 1)
    assert states(folder) == ["running"]
    work(folder, 1)
    assert [(config.scenario.layout_seed, config.seed) for config in played] == [(6, 0), (7, 0), (6, 1), (7, 1)]
    (again,) = read_trials(folder)
    assert (again.state, sum(one.cpu_s for one in again.trainings)) == ("complete", pytest.approx(4.0))
    assert len(again.trainings) == len({row["seed"] + row["layout_seed"] for row in rows_of(folder.table)}) == 4


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"stages": [{"top": 2, "seconds": 1, "layouts": [6]}]}, r"stages\[0\]: expected trials, and not top"),
        ({"stages": [PLAN["stages"][0], PLAN["stages"][0]]}, r"stages\[1\]: expected top, and not trials"),
        ({"stages": [PLAN["stages"][0], PLAN["stages"][1] | {"top": 9}]}, "top = 9: the stage before has 3 settings"),
        ({"arms": {"mapo": None}}, "did you mean 'mappo'"),
        ({"arms": {"iql": None}}, "no search space comes with 'iql'"),
        ({"stages": [{"trials": 3, "seconds": 1, "layouts": [6, 6]}]}, "one stands there twice"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Search.load(written(tmp_path / "plan.yaml", **changes))


def test_the_shipped_search_fits_four_hours_of_two_cores_and_chooses_on_layouts_for_choosing() -> None:
    shipped = Search.load(zoo_path("searches", "local"))
    assert shipped.cpu_s / 2 < 4 * 3600
    first, last = shipped.stages
    assert sorted(first.layouts + last.layouts) == [6, 7, 8, 9]  # the last stage ranks on layouts that chose nothing
    assert last.seeds == 3
    for name, arm in shipped.arms.items():
        assert {"hidden", "masks"} <= arm.space.dimensions.keys(), name
