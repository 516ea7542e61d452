"""``uavaou doctor``: it says what is there, and the line for what is not, also where nothing loads."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import uavaou
from tests.cli.commands import Shell
from uavaou.plain_yaml import parse_yaml
from uavaou_cli import doctor
from uavaou_cli.tables import WIDTH

ROOT = Path(__file__).resolve().parents[2]
HERE = {"torch": "2.13.0+cpu", "numba": "0.68.1", "numpy": "1.26.0", "optuna": "4.2", "mavsdk": "3.15"}
NEEDS = [
    "torch>=2.5",
    "numba>=0.61",
    'optuna<6,>=4.2; extra == "tune"',
    'mavsdk<5,>=4.1; extra == "link"',
    'uavaou[tune,link]; extra == "ray"',
]


def test_it_shows_versions_threads_caches_and_extras(shell: Shell) -> None:
    out = shell.done("doctor")
    assert out.startswith(f"uavaou {uavaou.__version__}, torch ")
    assert all(words in out for words in ("\nthreads: ", "\ncompiled code ", "\nfonts ", "\nfield "))
    assert out.splitlines()[-1] == "What every command needs is there, and training loads."
    assert all(len(line) <= WIDTH or "/" in line for line in out.splitlines())


def test_every_extra_is_told() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert doctor.EXTRAS.keys() == project["optional-dependencies"].keys() - {"docs", "dev"}


def test_what_is_missing_has_its_line(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    needs = list(NEEDS)
    monkeypatch.setattr(doctor, "requires", lambda package: needs)
    monkeypatch.setattr("uavaou.runs.machine.version", lambda package: HERE.get(package, "0"))
    lines = shell.done("doctor").splitlines()
    assert [line.split("pip install ")[1] for line in lines if "pip install" in line] == [
        "'uavaou[link]'",
        "'uavaou[ray]'",
    ]
    assert lines[lines.index("  link lacks mavsdk<5,>=4.1") + 1] == "  ray lacks mavsdk<5,>=4.1"
    needs += ["numpy>=2", "highspy>=1.11"]
    assert shell.done("doctor").endswith("To have them:\n  pip install 'numpy>=2' 'highspy>=1.11'\n")
    needs.clear()
    assert shell.done("doctor").endswith("  pip install FOLDER\n")


@pytest.mark.parametrize(
    ("broken", "told"),
    [
        ("torch", ["compiled code  0.0  {0}/numba", "fonts          0.0  {0}/fonts"]),
        ("numba", ["compiled code       unknown"]),
    ],
)
@pytest.mark.slow
def test_what_does_not_load_is_told(broken: str, told: list[str], tmp_path: Path) -> None:
    code = "import sys; sys.modules[sys.argv[1]] = None; from uavaou_cli.main import main; sys.exit(main(['doctor']))"
    places = {"NUMBA_CACHE_DIR": str(tmp_path / "numba"), "MPLCONFIGDIR": str(tmp_path / "fonts")}
    ran = subprocess.run(
        [sys.executable, "-c", code, broken], env=os.environ | places, capture_output=True, text=True, check=True
    )
    assert ran.stderr == ""
    assert "does not load" in ran.stdout
    for line in told:
        assert line.format(tmp_path) in ran.stdout


def test_a_report_of_a_bug_asks_for_it() -> None:
    asked = {}
    for name in ("bug", "feature"):
        form = parse_yaml((ROOT / ".github" / "ISSUE_TEMPLATE" / f"{name}.yml").read_text(encoding="utf-8"), name)
        assert form["name"]
        assert form["description"]
        asked[name] = {part["id"]: part for part in form["body"]}
    assert asked["bug"]["doctor"]["validations"] == {"required": True}
    assert "`uavaou doctor`" in asked["bug"]["doctor"]["attributes"]["label"]
