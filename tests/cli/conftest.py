"""A working folder with obstacles in it, and one with trained runs."""

import shlex
import shutil
from pathlib import Path

import pytest

from tests.cli.commands import TINY, runs
from uavaou_cli.main import main


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder but for a file in the way and two scenarios that cannot be used."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "circle").symlink_to("circle")
    (tmp_path / "outside.yaml").write_text("base: quickstart\ndevices: 1\ndevices_m: [[900, 10]]\n")
    (tmp_path / "map.csv").write_text("x_m,y_m\n900,10\n")
    for name in ("map.geojson", "map.yaml"):
        (tmp_path / name).write_text('{"type": "FeatureCollection", "features": []}')
    (tmp_path / "list.yaml").write_text("- paper\n")
    (tmp_path / "twins.json").write_text("{")
    return tmp_path


@pytest.fixture(scope="session")
def _trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which runs were trained, and some spoilt afterwards."""
    place = tmp_path_factory.mktemp("trained")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        (place / "file").write_text("in the way")
        for options in ("", "--set scenario.layout_seed=1", "--seed 1", "--seed 2"):
            assert main(shlex.split(f"{TINY} --algorithm mappo-paper {options}")) == 0
        paths = runs(place)
        (place / paths["broken"] / "checkpoints" / "best.safetensors").write_text("spoilt")
        fresh = place / paths["fresh"]
        (fresh / "episodes.csv").unlink()
        for checkpoint in (fresh / "checkpoints").iterdir():
            checkpoint.unlink()
    return place


@pytest.fixture
def trained(_trained: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder: one in which runs were trained."""
    monkeypatch.chdir(_trained)
    return _trained


@pytest.fixture
def released(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder, beside a package with one released policy, ``any-map``, that fits tiny."""
    policy, place, run = tmp_path / "policies" / "any-map", tmp_path / "place", trained / runs(trained)["run"]
    policy.mkdir(parents=True)
    place.mkdir()
    shutil.copy(run / "config.yaml", policy)
    shutil.copy(run / "checkpoints" / "best.safetensors", policy / "policy.safetensors")
    monkeypatch.setattr("uavaou.runs.released.zoo_folder", lambda kind: tmp_path / kind)
    monkeypatch.chdir(place)
    return place
