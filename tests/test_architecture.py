"""Imports point one way, the physics knows nothing of learning, and importing the package is quick."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LAYERS = (
    "errors",
    "files",
    "zoo",
    "fields",
    "csv_tables",
    "devices_csv",
    "scenario",
    "world",
    "envs",
    "algorithms",
    "statistics",
    "stratified",
    "trainings",
    "evaluation",
    "runs",
    "suites",
    "studies",
    "tuning",
    "reports",
    "uavaou_cli",
)

SEE_PLANNERS = ("planners", *LAYERS[LAYERS.index("evaluation") :])


def modules() -> list[Path]:
    return [*sorted((ROOT / "uavaou").rglob("*.py")), *sorted((ROOT / "cli").rglob("*.py"))]


def layer(parts: tuple[str, ...]) -> str:
    return "uavaou_cli" if parts[0] == "uavaou_cli" else parts[1].removesuffix(".py")


def imports(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
    return names


def test_every_module_is_looked_at() -> None:
    assert len(modules()) > 30


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_one_way(path: Path) -> None:
    parts = path.relative_to(ROOT / "cli" if "cli" in path.parts else ROOT).parts
    if parts == ("uavaou", "__init__.py"):
        return  # the public names, loaded on first use
    own = layer(parts)
    for name in imports(path):
        imported = tuple(name.split("."))
        if imported[0] == "uavaou_cli":
            assert own == "uavaou_cli", f"{own} imports {name}"
        if imported[0] != "uavaou" or len(imported) == 1:
            continue
        theirs = layer(imported)
        if "planners" in (own, theirs):
            assert own != "planners" or theirs in ("planners", "world", "scenario", "errors", "files"), (
                f"planners import {name}"
            )
            assert theirs != "planners" or own in (
                "planners",
                "evaluation",
                "runs",
                "suites",
                "studies",
                "tuning",
                "reports",
                "uavaou_cli",
            ), f"{own}: {name}"
        else:
            assert LAYERS.index(theirs) <= LAYERS.index(own), f"{own} imports {name}"


@pytest.mark.parametrize("path", sorted((ROOT / "uavaou" / "world").glob("*.py")), ids=lambda path: path.name)
def test_the_physics_knows_nothing_of_learning(path: Path) -> None:
    forbidden = {"torch", "stable_baselines3", "pettingzoo", "gymnasium", "supersuit", "matplotlib"}
    assert not {name.split(".")[0] for name in imports(path)} & forbidden


@pytest.mark.parametrize(
    ("statement", "absent"),
    [
        ("import uavaou", {"torch", "numpy", "pydantic"}),
        ("from uavaou import Scenario, World", {"torch", "gymnasium", "matplotlib"}),
        ("import uavaou.reports.figures, uavaou.reports.trajectories, uavaou.reports.audit", {"torch"}),
        ("import uavaou.reports.study_figures, uavaou.reports.claims_table, uavaou.studies.marl_eval", {"torch"}),
        ("import uavaou_cli.main", {"torch", "matplotlib", "scipy", "pydantic"}),
    ],
)
def test_nothing_heavy_is_imported_unasked(statement: str, absent: set[str]) -> None:
    code = f"import sys; {statement}; print(sorted(set({sorted(absent)!r}) & set(sys.modules)))"
    search = [str(ROOT), str(ROOT / "cli")]
    run = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = {search!r}; {code}"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert run.stdout.strip() == "[]"


def test_the_public_names_are_there() -> None:
    import uavaou

    for name in dir(uavaou):
        assert getattr(uavaou, name) is not None
    with pytest.raises(AttributeError, match="nothing_of_that_name"):
        uavaou.nothing_of_that_name  # noqa: B018
