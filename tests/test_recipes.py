"""The ten changes of docs/explanation/architecture.md, each made in one copy of the code and seen working."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.documents import ROOT

PAGE = ROOT / "docs" / "explanation" / "architecture.md"
MOST_FILES = 3


class Recipe(NamedTuple):
    """A change: file -> what is written into it, and a program that fails without the change."""

    edits: dict[str, Callable[[str], str]]
    check: str


def put(*changes: tuple[str, str]) -> Callable[[str], str]:
    """Put a text in the place of another, which stands in the file once; several of them."""

    def edit(content: str) -> str:
        for old, text in changes:
            assert content.count(old) == 1, old
            content = content.replace(old, text)
        return content

    return edit


def ahead(anchor: str, text: str) -> tuple[str, str]:
    """The change that puts a text ahead of another."""
    return anchor, text + anchor


def new(text: str) -> Callable[[str], str]:
    """Write a file that is not there."""

    def edit(content: str) -> str:
        assert content == ""
        return text

    return edit


CIRCLE = '''"""A planner that circles."""

import numpy as np

from uavaou.arrays import Bools, Ints
from uavaou import World


class Circle:
    """Fly up, right, down, left, whatever the devices do."""

    def reset(self, world: World, seed: int) -> None:
        """Begin anew."""

    def act(self, world: World) -> tuple[Ints, Bools | None]:
        """The same move for all UAVs, (N, U)."""
        move = (1, 3, 2, 4)[world.slot % 4]
        return np.full((world.missions, world.scenario.uavs), move), None
'''
COMMAND = '''"""``uavaou hello``."""


def hello() -> None:
    """Say hello."""
    print("hello")
'''
LEARNER = (ROOT / "examples" / "plain_ppo.py").read_text(encoding="utf-8")

FORMAT = '"safetensors", "sb3", "onnx")] = "safetensors"'
SAVED = '        if format == "safetensors":\n            model.save(out)\n'
AS_TEXT = '        if format == "text":\n            out.write_text(str(model.policy))\n        elif format'
RECIPES = {
    "planner": Recipe(
        {
            "uavaou/planners/circle.py": new(CIRCLE),
            "uavaou/planners/__init__.py": put(
                ('    "random": ', '    "circle": "uavaou.planners.circle:Circle",\n    "random": ')
            ),
        },
        "assert evaluate('circle', 'tiny', 1).violations['rate'] == 0",
    ),
    "observation column": Recipe(
        {
            "uavaou/world/views.py": put(
                ('("slots_left", 1), ("budget_left", 1)]', '("slots_left", 1), ("budget_left", 1), ("half", 1)]'),
                ('        at["budget_left"][', '        at["half"][...] = 0.5\n        at["budget_left"]['),
            )
        },
        "env = flatten('tiny', 2); columns = env.row_layout.local_columns('half')\n"
        "assert (env.reset()[:, columns] == 0.5).all()",
    ),
    "learner": Recipe(
        {"own_ppo.py": new(LEARNER)},
        "from uavaou.algorithms.registry import load_plugin; load_plugin('own_ppo.py')\n"
        "assert RunConfig.load('plain-ppo', 'tiny').algorithm.name == 'plain-ppo'",
    ),
    "scenario field": Recipe(
        {
            "uavaou/scenario_fields.py": put(
                ("    rate_min_bit_s: Positive", "    rain_db: NonNegative = 0.0\n    rate_min_bit_s: Positive")
            ),
            "uavaou/scenario.py": put(
                ("10 ** (self.noise_power_dbm / 10)", "10 ** ((self.noise_power_dbm + self.rain_db) / 10)")
            ),
        },
        "skies = [Scenario.load('tiny').replace(rain_db=rain) for rain in (0, 40)]\n"
        "dry, wet = (evaluate('greedy', sky, 1).mean_aou_slots for sky in skies)\n"
        "assert wet > dry",
    ),
    "metric": Recipe(
        {
            "uavaou/world/world.py": put(
                ahead("    rejected_rate: Ints  # (N,)", "    flown_steps: Ints  # (N,)\n"),
                (
                    "            rejected_rate=",
                    "            flown_steps=self.flown.sum(axis=1),\n            rejected_rate=",
                ),
            ),
            "uavaou/evaluation/flights.py": put(
                ('    "rejected_rate": NUMBER', '    "flown_steps": NUMBER,\n    "rejected_rate": NUMBER')
            ),
            "uavaou/evaluation/flown.py": put(("_COUNTS = (", '_COUNTS = ("flown_steps", ')),
        },
        "assert main(['eval', '--policy', 'greedy', '--scenario', 'tiny', '--episodes', '2', '--out', 'e.csv']) == 0\n"
        "assert (pandas.read_csv('e.csv')['flown_steps'] > 0).all()",
    ),
    "figure": Recipe(
        {
            "uavaou/reports/figures.py": put(
                (
                    "        validations = self",
                    "        if shown:\n"
                    "            figures['figure-9'] = self._training_figure(shown, drawing.AOU, validated)\n"
                    "        validations = self",
                )
            )
        },
        "from tests.synthetic_study import MAPPO, write_study\n"
        "from uavaou.reports.figures import plot_study\n"
        "study = write_study(Path('study'), {'mappo': MAPPO}, {}, 1, missions=2, bound=None)\n"
        "drawn = plot_study(study, Path('drawn'))\n"
        "assert 'figure-9.png' in {path.name for path in drawn}",
    ),
    "suite": Recipe(
        {
            "zoo_configs/suites/heights.yaml": new(
                "description: The altitude\nscenario: tiny\naxis: {label: altitude, unit: m}\n"
                "points:\n  - {label: low, x: 80, set: {altitudes_m: [80, 85]}}\n"
            )
        },
        "assert main(['eval', '--policy', 'greedy', '--suite', 'heights', '--episodes', '2']) == 0",
    ),
    "study": Recipe(
        {
            "zoo_configs/studies/rules.yaml": new(
                "seeds: 1\nscenarios: [tiny]\nvariants: {mappo: {set: {slots: 96}}}\nplanners: [greedy]\nepisodes: 2\n"
            )
        },
        "assert main(['study', 'status', 'rules']) == 0",
    ),
    "file format": Recipe(
        {
            "cli/uavaou_cli/export.py": put(
                (FORMAT, FORMAT.replace('"onnx"', '"onnx", "text"')),
                (SAVED, AS_TEXT + SAVED.removeprefix("        if format")),
            )
        },
        "assert main(['export', 'any-map', '--format', 'text', '--out', 'network.txt']) == 0\n"
        "assert 'pull' in Path('network.txt').read_text()",
    ),
    "command": Recipe(
        {
            "cli/uavaou_cli/hello.py": new(COMMAND),
            "cli/uavaou_cli/main.py": put(
                (
                    'app.command("train", ',
                    'app.command("hello")(__import__("uavaou_cli.hello").hello.hello)\napp.command("train", ',
                )
            ),
        },
        "assert main(['hello']) == 0",
    ),
}


def stated() -> dict[str, list[str]]:
    """Change -> the files that the page names for it."""
    table = PAGE.read_text(encoding="utf-8").partition("## Ten changes")[2].partition("\n## ")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines() if line.startswith("| a new ")]
    return {row[0].removeprefix("a new "): re.findall(r"`([\w./-]+)`", row[1]) for row in rows}


def test_the_page_names_the_files_of_each_change() -> None:
    pages = stated()
    assert pages.keys() == RECIPES.keys()
    assert len(pages) == 10
    for name, recipe in RECIPES.items():
        there = [Path(path).parent for path in recipe.edits]
        assert 1 <= len(recipe.edits) <= MOST_FILES
        assert [Path(path) if path.endswith("/") else Path(path).parent for path in pages[name]] == there, name


@pytest.mark.slow
def test_each_change_works_in_a_copy(tmp_path: Path) -> None:
    ignore = shutil.ignore_patterns("__pycache__")
    for folder in ("uavaou", "cli", "zoo_configs", "tests"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=ignore)
    code = [
        "from pathlib import Path; import pandas",
        "from uavaou import RunConfig, Scenario, evaluate, flatten; from uavaou_cli.main import main",
    ]
    for name, recipe in RECIPES.items():
        for path, edit in recipe.edits.items():
            file = tmp_path / path
            file.write_text(edit(file.read_text() if file.exists() else ""))
        code += [recipe.check, f"print({f'{name} works'!r})"]
    surroundings = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (tmp_path, tmp_path / "cli")))}
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(code)], cwd=tmp_path, env=surroundings, capture_output=True, text=True
    )
    assert [name for name in RECIPES if f"{name} works\n" not in done.stdout] == [], done.stderr[-2000:]
