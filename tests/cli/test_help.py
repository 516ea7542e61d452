"""The commands and their options, and how quickly they answer."""

import re
import runpy
import subprocess
import sys
from collections.abc import Iterable
from typing import Any

import pytest
import typer

from tests.cli.commands import Shell, run_process
from uavaou.algorithms.registry import algorithm_names
from uavaou.planners import PLANNERS
from uavaou_cli.main import app, main
from uavaou_cli.tables import WIDTH

# Scripts and docs rely on every one of these.
COMMANDS = {
    "": "--version --plugin --install-completion --show-completion",
    "train": "SCENARIO --scenario --family --algorithm --seed --slots --config --from --continue --out "
    "--resume --checkpoint-every --device --threads --backend --set --quiet",
    "tune": "SCENARIO --scenario --algorithm --seconds --slots --trials --from --top --space --jobs --seed --out "
    "--set --search --quiet",
    "eval": "RUN --policy --scenario --episodes --seed --action --suite --time-limit --knows --out --set --quiet",
    "import": "FILE --out --uavs --station --radio --crs --speed --endurance --interval --within --duration --swap "
    "--altitude --grid-step --slots --replace",
    "fly": "SCENARIO --scenario --policy --seconds --knows --seed --json --out --route --uavs --station --radio --crs "
    "--speed --endurance --interval --within --duration --swap --what-if --set --quiet",
    "replay": "RUN|POLICY --scenario --seed --format --out --slots --time-limit --knows --set --quiet",
    "plan": "SCENARIO --scenario --planner --time-limit --episodes --seed --out --replace --set --quiet",
    "route": "SCENARIO --scenario --policy --seconds --knows --format --episodes --seed --out --set --quiet",
    "gap": "SCENARIO RUN --scenario --time-limit --bound-limit --certificate --episodes --seed --set --quiet",
    "audit": "SCENARIO --scenario --out --set",
    "export": "RUN --out --format --scenario",
    "size": "SCENARIO --scenario --uavs --target --station --speed --endurance --seconds --knows --out --what-if --set "
    "--quiet",
    "link": "URL --scenario --uav --policy --arm --devices --silence --seed --out",
    "runs": "--out",
    "scenarios": "",
    "doctor": "",
    "plot": "",
    "plot figures": "RUN --out",
    "plot suite": "FILE --out",
    "plot trajectories": "RUN --episode-seed --out",
    "study": "",
    "study run": "STUDY --jobs --engine --address --out --checkpoint-every --quiet",
    "study status": "STUDY --out",
    "study report": "STUDY --out",
}


def surface(command: Any, path: str = "") -> dict[str, str]:
    """The arguments and options of a command and of those below it."""
    names = [name for param in command.params for name in spellings(param)]
    below = getattr(command, "commands", {})
    found = {path: " ".join(names)}
    for name, inner in below.items():
        found |= surface(inner, f"{path} {name}".strip())
    return found


def spellings(param: Any) -> list[str]:
    return list(param.opts) if param.param_type_name == "option" else [param.metavar or param.name.upper()]


def test_the_commands_and_options_are_these() -> None:
    assert surface(typer.main.get_command(app)) == COMMANDS


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["train", "--help"], ["plot"], ["eval", "-h"]])
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    heavy = ("torch", "matplotlib", "scipy", "numpy", "rich", "yaml")
    done = run_process(*arguments, after=f"print([m for m in {heavy} if m in sys.modules], file=sys.stderr)")
    assert (done.returncode, done.stderr) == (0, "[]\n")
    assert done.stdout
    assert all(len(line) <= WIDTH for line in done.stdout.splitlines())


def test_the_package_runs_and_says_its_version(
    shell: Shell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import uavaou

    assert shell("--version") == (0, f"uavaou {uavaou.__version__}\n", "")
    monkeypatch.setattr(sys, "argv", ["python -m uavaou", "--version"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module("uavaou", run_name="__main__")
    assert (ended.value.code, capsys.readouterr().out.startswith("uavaou ")) == (0, True)


@pytest.mark.parametrize(
    ("words", "completed"),
    [
        ("uavaou sc", ["scenarios"]),
        ("uavaou fly pap", ["paper", "paper-table1"]),
        ("uavaou export any", ["any-map"]),
        ("uavaou export run --format o", ["onnx"]),
        ("uavaou study run sm", ["smoke"]),
        ("uavaou plot t", ["trajectories"]),
        ("uavaou fly nothing-like-it", []),
    ],
)
def test_a_shell_completes(
    words: str, completed: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("_UAVAOU_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
    with pytest.raises(SystemExit) as ended:
        main([])
    assert (ended.value.code, capsys.readouterr().out.split()) == (0, completed)


@pytest.mark.parametrize(("command", "names"), [("eval", PLANNERS), ("train", algorithm_names())])
def test_help_names_all(command: str, names: Iterable[str], shell: Shell) -> None:
    out = shell.out(f"{command} --help")
    assert all(name in re.sub(r"-\n +", "-", out) for name in names)


def test_scenarios_fit_a_terminal_and_audit_prints(shell: Shell) -> None:
    out = shell.done("scenarios")
    assert {"paper", "paper-table1", "quickstart", "tiny"} <= set(out.split())
    assert all(len(line) <= WIDTH for line in out.splitlines())
    out = shell.done("audit quickstart")
    assert "0 errors" in out
    code, out, err = shell("audit --scenario paper-table1")
    assert (code, err) == (1, "")
    assert "5 errors" in out
    assert "3 devices" in shell("audit quickstart --set scenario.devices=3")[1]


def test_a_reader_that_stops_early_is_no_error() -> None:
    command = "import sys; from uavaou_cli.main import main; sys.exit(main(['scenarios']))"
    process = subprocess.Popen(
        [sys.executable, "-c", command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    process.stdout.close()
    assert process.stderr.read() == ""
    process.stderr.close()
    process.wait()
