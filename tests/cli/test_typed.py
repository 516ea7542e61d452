"""What a person types and reads: budgets in short, names in capitals, commands that a shell takes as they are."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from tests.cli.commands import Shell
from uavaou import Scenario
from uavaou.errors import command_line
from uavaou_cli.overrides import parse_overrides


@pytest.mark.parametrize("text", ["96", "9.6e1", "0.096k", "0_96"])
def test_a_budget_may_be_typed_in_short(shell: Shell, workplace: Path, text: str) -> None:
    (workplace / "results" / "tiny").mkdir(parents=True)
    (workplace / "results" / "tiny" / "vdn+slots=96").write_text("in the way")
    err = shell.refused(f"train tiny --slots {text} --algorithm VDN")
    assert "results/tiny/vdn+slots=96" in err


@pytest.mark.parametrize("text", ["many", "1.5", "1G", "k", "", "1e400", "nan"])
def test_another_budget_is_refused(shell: Shell, workplace: Path, text: str) -> None:
    for command in ("train tiny", "tune tiny"):
        err = shell.refused(shlex.join([*command.split(), "--slots", text]))
        assert err.startswith("uavaou: --slots ")
        assert "whole number, such as 200000, 200k or 1e6" in err or "at most 1,000,000,000,000" in err


def test_commands_are_quoted_only_where_a_shell_needs_it() -> None:
    words = ["uavaou", "eval", "results/valley~1a2b/mappo+slots=60000/seed-0", "~x", "layout 1", ""]
    line = command_line(words)
    assert line == "uavaou eval results/valley~1a2b/mappo+slots=60000/seed-0 '~x' 'layout 1' ''"
    assert shlex.split(line) == words


def test_a_folder_above_runs_says_which_they_are(shell: Shell, workplace: Path) -> None:
    for seed in range(7):
        run = workplace / "r" / "mappo" / f"seed-{seed}"
        run.mkdir(parents=True)
        (run / "config.yaml").write_text("")
    code, _, err = shell("eval r")
    assert code == 2
    assert "'r' is not a run folder" in err
    assert "runs below it: r/mappo/seed-0, r/mappo/seed-1, " in err
    assert err.endswith(" and 2 more\n")


def test_overrides_reach_into_ranges_and_leave_the_rest() -> None:
    items = ["scenario.bandwidth_hz.low=14e3", "scenario.layout_seed=7", "algorithm.learning_rate=1e-4"]
    overrides = parse_overrides(items)
    base = Scenario.load("quickstart")
    changed = overrides.of_scenario(base).to_dict()
    assert changed == base.to_dict() | {"bandwidth_hz": {"low": 14e3, "high": 2e4}, "layout_seed": 7}
    assert overrides.of_algorithm("ippo").model_dump()["learning_rate"] == 1e-4
