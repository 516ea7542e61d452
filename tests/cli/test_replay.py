"""``uavaou replay``: which missions it takes, what it prints and writes."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from tests.cli.commands import Shell, runs
from tests.synthetic_study import record


def names(page: Path) -> list[str]:
    """The policies whose flights a page holds."""
    return re.findall(r'"name":"([^"]*)","cells"', page.read_text(encoding="utf-8"))


def test_it_writes_a_page_and_prints_the_figures(shell: Shell, workplace: Path) -> None:
    out = shell.done("replay greedy best-first --scenario tiny --set scenario.layout_seed=2 --quiet")
    page = Path("results/tiny+layout_seed=2/replay/greedy,best-first/mission-10000.html")
    assert out.splitlines()[-1] == str(page)
    assert out.startswith("tiny with layout_seed=2: 1 mission, seed 10000")
    assert names(page) == ["greedy", "best-first"]


def test_recorded_missions_stand_beside_flown_ones(shell: Shell, workplace: Path) -> None:
    for policy in ("mappo", "vdn"):
        record(workplace, policy)  # on tiny, seed 5
    code, out, _ = shell("replay mission-vdn.json stay ./mission-mappo.json --out x.html --quiet")
    assert (code, "tiny: 1 mission, seed 5" in out) == (0, True)
    assert names(Path("x.html")) == ["VDN, seed 0", "stay", "MAPPO, seed 0"]
    assert shell("replay mission-vdn.json --out y.html") == (0, "y.html\n", "")
    for command, reason in (
        ("replay mission-vdn.json stay --seed 6", "they differ in mission_seed"),
        ("replay mission-vdn.json stay --scenario quickstart", "they differ in scenario"),
    ):
        code, _, err = shell(f"{command} --out z.html --quiet")
        assert (code, reason in err, err.count("\n")) == (2, True, 1)
        assert not Path("z.html").exists()


@pytest.mark.slow
def test_it_takes_runs_and_writes_films(
    shell: Shell, trained: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    run = runs(trained)["run"]
    out = shell.done(f"replay {run} stay --seed 7 --out {tmp_path}/x.html --quiet")
    assert names(tmp_path / "x.html") == ["mappo-paper, seed 0", "stay"]
    monkeypatch.setattr("uavaou_cli.progress._LINE_EVERY_S", 0)
    code, out, err = shell(f"replay stay --scenario tiny --out {tmp_path}/x.gif")
    assert (code, out.splitlines()[-1]) == (0, f"{tmp_path}/x.gif")
    assert "gif: " in err
    assert (tmp_path / "x.gif").read_bytes().startswith(b"GIF89a")


def test_mp4_names_the_extra_that_it_needs(shell: Shell, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    err = shell.refused("replay stay --scenario tiny --format mp4")
    assert "--format mp4: 'av' is not installed: pip install 'uavaou[video]'" in err
    assert not (workplace / "results").exists()
