"""The wheel, away from the repository: zoo and replay page are inside, and nothing is installed as a bare ``cli``."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
pytest.importorskip("hatchling")


@pytest.mark.slow
def test_a_wheel_carries_the_zoo(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "again"):
        build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
        subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("uavaou-*.whl")
    assert wheel.read_bytes() == (tmp_path / "again" / wheel.name).read_bytes()
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    tops = {path.name for path in site.iterdir() if not path.name.endswith(".dist-info")}
    assert tops == {"uavaou", "uavaou_cli"}
    assert (site / "uavaou" / "py.typed").is_file()
    web = Path("uavaou", "reports", "replay", "web")
    assert {path.name for path in (site / web).iterdir()} == {path.name for path in (ROOT / web).iterdir()}
    ours = [str(ROOT), str(ROOT / "cli")]
    kinds = {path.name for path in (ROOT / "zoo_configs").iterdir()}
    assert kinds == {path.name for path in (site / "uavaou" / "zoo_configs").iterdir()}
    code = (
        f"import sys; sys.path[:] = [{str(site)!r}] + [p for p in sys.path if p not in {ours!r}]\n"
        "import uavaou; assert uavaou.__file__.startswith(sys.path[0]), uavaou.__file__\n"
        "from uavaou_cli.main import main; main(['scenarios'])"
    )
    shown = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True, text=True)
    for preset in ("paper", "paper-table1", "quickstart", "tiny"):
        assert preset in shown.stdout
