"""``uavaou runs`` lists the trainings, and the shell completes their names."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.commands import Shell
from uavaou_cli.options import trained


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell) -> Path:
    """A folder with two trainings, of which one changed more than a name can say."""
    monkeypatch.chdir(tmp_path)
    more = " --set algorithm.gamma=0.9 --set algorithm.clip_range=0.3 --set algorithm.max_gradient_norm=9"
    for settings in ("", more):
        line = "train tiny --algorithm ippo --slots 60 --set algorithm.missions=2 --set algorithm.hidden=[8] --quiet"
        assert shell(line + settings)[0] == 0
    return tmp_path


def test_they_are_listed_with_what_each_changed_and_reached(place: Path, shell: Shell) -> None:
    (other,) = (path.name for path in (place / "results/tiny").glob("ippo+*") if "=" not in path.name)
    (place / "results/tiny" / other / "seed-0/meta.json").unlink()
    damaged = place / "results/tiny/vdn/seed-0/config.yaml"
    damaged.parent.mkdir(parents=True)
    damaged.write_text("schema: 1\n")
    out = shell.done("runs")
    lines = out.splitlines()
    assert lines[0].split() == ["run", "slots", "mean", "AoU", "state"]
    found = {line.split()[0]: line.split()[1:] for line in lines[1:] if line.startswith("results")}
    first = found["results/tiny/ippo+hidden=%5B8%5D,missions=2,slots=60/seed-0"]
    assert (first[0], first[2]) == ("120", "finished")  # a whole rollout
    assert float(first[1]) > 0
    assert found[f"results/tiny/{other}/seed-0"] == ["begun"]
    assert found["results/tiny/vdn/seed-0"] == ["damaged"]
    changed = "slots=60, missions=2, hidden=[8], gamma=0.9, clip_range=0.3, max_gradient_norm=9.0"
    assert changed in " ".join(out.split())
    assert "vdn/seed-0/config.yaml" in out


def test_their_names_are_completed(place: Path) -> None:
    assert "any-map" in trained("")
    found = trained("results/tiny/ippo")
    assert len(found) == 2
    assert all((place / name / "config.yaml").is_file() for name in found)
    assert trained("nothing") == []
