"""The wheel, away from the repository: it holds every file of the code and of the zoo, and its commands find them."""

import subprocess
import sys
import zipfile
from email import message_from_string
from pathlib import Path

import pytest

import uavaou

ROOT = Path(__file__).resolve().parents[1]
HOMES = {"uavaou": "uavaou", "cli/uavaou_cli": "uavaou_cli", "zoo_configs": "uavaou/zoo_configs"}
pytest.importorskip("hatchling")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    return next(folder.glob("*.whl"))


def test_a_wheel_built_twice_has_the_same_bytes(wheel: Path, tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    assert wheel.read_bytes() == (tmp_path / wheel.name).read_bytes()


def test_a_wheel_holds_the_code_and_the_zoo_and_nothing_else(wheel: Path) -> None:
    expected = {
        f"{there}/{path.relative_to(ROOT / here).as_posix()}"
        for here, there in HOMES.items()
        for path in (ROOT / here).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
        metadata = message_from_string(archive.read(f"uavaou-{uavaou.__version__}.dist-info/METADATA").decode())
    assert names == expected
    assert {"uavaou/py.typed", "uavaou/zoo_configs/scenarios/paper.yaml", "uavaou/reports/replay/web/page.html"} < names
    assert metadata["Requires-Python"] == ">=3.11"
    assert {"field", "onnx", "link", "video", "tune", "ray"} < set(metadata.get_all("Provides-Extra", []))


def test_its_modules_load_and_its_commands_run_from_an_empty_folder(wheel: Path, tmp_path: Path) -> None:
    site, empty = tmp_path / "site", tmp_path / "empty"
    empty.mkdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    ours = [str(ROOT), str(ROOT / "cli")]
    code = f"""
import sys
sys.path[:] = [{str(site)!r}] + [place for place in sys.path if place not in {ours!r}]
import importlib, pkgutil, uavaou, uavaou_cli
for package in (uavaou, uavaou_cli):
    assert package.__file__.startswith({str(site)!r}), package.__file__
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not module.name.endswith(("__main__", "ortools_process")):  # OR-Tools and HiGHS do not share a process
            importlib.import_module(module.name)
from uavaou_cli.main import main
for command in ("scenarios", "doctor", "audit tiny", "train --help", "export any-map --out any-map"):
    assert main(command.split()) == 0, command
"""
    shown = subprocess.run([sys.executable, "-c", code], cwd=empty, capture_output=True, text=True)
    assert shown.returncode == 0, shown.stderr
    for words in ("paper-table1", "quickstart", f"uavaou is in {site / 'uavaou'}", "0 errors", "--algorithm"):
        assert words in shown.stdout
