"""The command ``uavaou``: its subcommands, and one line on stderr for every user error.

No heavy module is imported here or at the top of a command's module, so that ``uavaou --help`` answers at once.
"""

import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from itertools import pairwise
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from uavaou.errors import InputError, nearest, unknown
from uavaou.runs.interrupt import exit_code, interrupt_at_sigterm, was_interrupt
from uavaou_cli import (
    doctor,
    evaluate,
    export,
    fly,
    import_,
    link,
    plan,
    plot,
    replay,
    route,
    runs,
    scenarios,
    size,
    study,
    train,
    tune,
)
from uavaou_cli.options import given_path, option

BAD_INPUT = 2
LONGEST_COMPLAINT = 2000  # characters
_PATHS = ("--out", "--json", "--config", "--space")  # options whose values are paths

# Typer exports one usage error; its base class covers all of them, wherever this Typer keeps its Click.
_USAGE_ERROR: type[Exception] = typer.BadParameter.__mro__[1]


class _Commands(TyperGroup):
    """Suggests the nearest command for an unknown one, and answers an interrupt, whatever the version of Typer."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            raise unknown("command", args[0], self.list_commands(ctx))
        return super().resolve_command(ctx, args)

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        with _answered():
            return super().make_context(*arguments, **options)

    def invoke(self, ctx: Any) -> Any:
        with _answered():
            return super().invoke(ctx)


@contextmanager
def _answered() -> Iterator[None]:
    """Answer an interrupt, with which Typer would end without a word."""
    try:
        yield
    except KeyboardInterrupt as error:
        raise typer.Exit(_complain("interrupted", exit_code(error))) from None


_STYLE: dict[str, Any] = {
    "cls": _Commands,
    "invoke_without_command": True,
    "context_settings": {"help_option_names": ["-h", "--help"], "max_content_width": 100},
    "rich_markup_mode": None,  # rich alone takes longer to import than the help takes to print
}
app = typer.Typer(**_STYLE, pretty_exceptions_enable=False)
app.command("import", short_help="Make a scenario of maps, missions and tables of sensors.")(import_.import_)
app.command("fly", short_help="Fly one mission of a scenario and draw its map.")(fly.fly)
app.command("train", short_help="Train a policy.")(train.train)
app.command("tune", short_help="Search for better settings of an algorithm.")(tune.tune)
app.command("eval", short_help="Play trained runs and planners on the same missions.")(evaluate.evaluate)
app.command("replay", short_help="Replay one mission of several policies in a browser.")(replay.replay)
app.command("plan", short_help="Plan a fleet's routes before take-off.")(plan.plan)
app.command("route", short_help="Write what a policy flies as files for autopilots.")(route.route)
app.command("size", short_help="Find the smallest fleet that keeps data fresh enough.")(size.size)
app.command("gap", short_help="Compare planners and runs with the lower bound.")(plan.gap)
plots = typer.Typer(**_STYLE, help="Draw the figures of studies and training runs, or one mission.")
plots.command("figures", short_help="Draw the figures of studies or training runs.")(plot.figures)
plots.command("suite", short_help="Draw the tables of evaluation suites.")(plot.suite)
plots.command("trajectories", short_help="Draw one mission of a run.")(plot.trajectories)
app.add_typer(plots, name="plot")
studies = typer.Typer(**_STYLE, help="Many runs: algorithms, seeds and scenarios, resumable, with condensed results.")
studies.command("run", short_help="Run what is left of a study.")(study.run)
studies.command("status", short_help="Show how its runs stand.")(study.status)
studies.command("report", short_help="Rewrite its condensed results and print the table.")(study.report)
app.add_typer(studies, name="study")
app.command("audit", short_help="Check a scenario's link budget and numbers.")(scenarios.audit)
app.command("export", short_help="Write a trained run for another tool.")(export.export)
app.command("link", short_help="Fly one UAV by a policy over MAVLink.")(link.link)
app.command("runs", short_help="List the trainings, what each changed and reached.")(runs.runs)
app.command("scenarios", short_help="List the scenarios that come with uavaou.")(scenarios.scenarios)
app.command("doctor", short_help="Show what this installation has and lacks.")(doctor.doctor)


def _version(wanted: bool) -> None:
    if wanted:
        from uavaou import __version__

        print(f"uavaou {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    ctx: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    plugin: Annotated[
        list[str] | None, option("Import this first; it registers algorithms. Repeatable.", "FILE.py|MODULE")
    ] = None,
) -> None:
    """Train, evaluate and explain teams of UAVs that keep IoT data fresh.

    Start with:  uavaou fly paper
    """
    _help_when_alone(ctx)
    for before, word in pairwise(["", *ctx.obj["arguments"]]):
        for path in _PATHS:
            if (before, word) == (path, "") or word == f"{path}=":  # Path("") would mean the present folder
                given_path(path, "")
    ctx.obj["plugins"] = plugin or []
    for place in plugin or []:
        from uavaou.algorithms.registry import load_plugin

        load_plugin(place)


@plots.callback()
@studies.callback()
def _help_when_alone(ctx: typer.Context) -> None:
    if ctx.invoked_subcommand is None:
        print(ctx.get_help())


_command = cache(partial(typer.main.get_command, app))  # built once for all calls of main in a process


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 2 for bad input, 130 or 143 after a signal.

    It is 1 when stdout is closed, and when an audit finds errors.

    Bad input is one line on stderr. Any other exception is a bug and keeps its traceback.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    terminated = signal.getsignal(signal.SIGTERM)
    interrupt_at_sigterm(signal.SIG_DFL)
    os.environ["MPLBACKEND"] = "agg"  # that of a notebook, which a command inherits, may not be installed here
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names that the console has no letters for are escaped
            stream.reconfigure(errors="backslashreplace")
    warnings.formatwarning = lambda message, *_, **__: f"uavaou: warning: {message}\n"
    try:
        code = _command()(arguments, prog_name="uavaou", standalone_mode=False, obj={"arguments": arguments})
        sys.stdout.flush()  # a reader that has gone away shows here, not in the interpreter's last moments
    except InputError as error:
        return _complain("\n  ".join(map(_cut, error.lines)), BAD_INPUT)
    except _USAGE_ERROR as error:
        return _complain(_cut(_explain_usage(error)), BAD_INPUT)
    except (typer.Abort, KeyboardInterrupt) as error:
        return _complain("interrupted", exit_code(error))
    except SystemError as error:
        if not was_interrupt(error):
            raise
        return _complain("interrupted", exit_code(error))
    except BrokenPipeError:  # uavaou ... | head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, terminated or signal.SIG_DFL)
    return code if isinstance(code, int) else 0


def _cut(message: str) -> str:
    """What was typed may be of any length: show how it begins, and what is allowed."""
    half = LONGEST_COMPLAINT // 2
    return message if len(message) <= LONGEST_COMPLAINT else f"{message[:half]} ... {message[-half:]}"


def _complain(message: str, code: int) -> int:
    print(f"uavaou: {message}", file=sys.stderr)
    return code


def _misread_number(error: Any) -> str | None:
    """The message for an option that is not a number; Typer's own, from pydantic, leaves out the value."""
    from pydantic import ValidationError

    from uavaou.fields import short

    option = next(iter(getattr(getattr(error, "param", None), "opts", ())), None)
    if option is None or not isinstance(error.__cause__, ValidationError):
        return None
    found = error.__cause__.errors(include_url=False)[0]
    expected = {"int": "a whole number, such as 4", "float": "a number, such as 0.5"}.get(found["type"].split("_")[0])
    return None if expected is None else f"{option} = {short(found['input'])}: expected {expected}"


def _explain_usage(error: Any) -> str:
    """One line for a usage error of Typer's, with the nearest option and the help to read."""
    ctx = getattr(error, "ctx", None)
    if getattr(error, "option_name", None) == "--plugin":
        message = "--plugin stands before the command: uavaou --plugin FILE.py train ..."
    elif (misread := _misread_number(error)) is not None:
        message = misread
    elif hasattr(error, "possibilities"):
        options = [name for param in ctx.command.params for name in param.opts] if ctx is not None else []
        message = f"unknown option {error.option_name!r}{nearest(error.option_name, options)}"
    else:
        message = " ".join(error.format_message().split()).rstrip(".")
        message = message[:1].lower() + message[1:]
    return f"{message} (see {ctx.command_path} --help)" if ctx is not None else message
