"""The options that several commands share, and the checks of values, paths and devices before anything is computed."""

import tempfile
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any

import typer

from uavaou.errors import InputError, unknown
from uavaou.evaluation.seeds import LARGEST_SEED, MOST_EPISODES

MOST_SLOTS = 10**12


def option(help: str, metavar: str = "NAME", *names: str) -> Any:
    """An option for text or a path; ``names`` where the parameter's own does not serve."""
    return typer.Option(*names, metavar=metavar, help=help)


def number(help: str, lowest: float, highest: float = float("inf"), metavar: str = "N") -> Any:
    """An option for a number from ``lowest`` to ``highest``."""

    def check(option: typer.CallbackParam, value: Any) -> Any:
        if value is not None and not lowest <= value <= highest:  # nan is in no range
            limit = f"at most {highest}" if value > highest else f"at least {lowest}"
            raise InputError(f"{option.opts[0]} {value}: must be {limit}")
        return value

    return typer.Option(metavar=metavar, help=help, callback=check)


_MULTIPLES = {"k": 10**3, "M": 10**6}


def budget(help: str) -> Any:
    """An option for a whole number above 0, typed as ``200000``, ``200_000``, ``200k``, ``1e6`` or ``1M``."""

    def parse(text: str) -> Any:
        with suppress(ArithmeticError, ValueError):
            number = Decimal(text[:-1] if text[-1:] in _MULTIPLES else text) * _MULTIPLES.get(text[-1:], 1)
            if number.is_finite() and abs(number) > MOST_SLOTS:  # as an integer it could have a billion digits
                return number
            if number == int(number):
                return int(number)
        return text  # is refused below: an error here would lose its message

    def check(option: typer.CallbackParam, value: Any) -> Any:
        if isinstance(value, str):
            raise InputError(f"{option.opts[0]} = {value}: expected a whole number, such as 200000, 200k or 1e6")
        if value is not None and not 1 <= value <= MOST_SLOTS:
            limit = f"at most {MOST_SLOTS:,}" if value > MOST_SLOTS else "at least 1"
            shown = value if isinstance(value, int) else f"{value:.3e}"
            raise InputError(f"{option.opts[0]} {shown}: must be {limit}")
        return value

    return typer.Option(metavar="N", help=help, parser=parse, callback=check)


def seconds(help: str) -> Any:
    """An option for a budget of time, in seconds above 0."""

    def check(option: typer.CallbackParam, value: Any) -> Any:
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"{option.opts[0]} {value:g}: must be a positive number of seconds")
        return value

    return typer.Option(metavar="S", help=help, callback=check)


def shipped(kind: str) -> Callable[[str], list[str]]:
    """What a shell completes: the names of a kind that come with the package; files, where none begins like that."""

    def complete(incomplete: str) -> list[str]:
        from uavaou.zoo import zoo_names

        return [name for name in zoo_names(kind) if name.startswith(incomplete)]

    return complete


def trained(incomplete: str) -> list[str]:
    """What a shell completes: released policies, and the trainings in the folder of results."""
    from uavaou.runs.released import released_names

    runs = (str(path.parent) for path in sorted(Path("results").glob("*/*/seed-*/config.yaml")))
    return [name for name in (*released_names(), *runs) if name.startswith(incomplete)]


def choice(help: str, *allowed: str, values: Collection[str] = ()) -> Any:
    """An option for one of the ``allowed`` words; another word gets the nearest one as a hint.

    Args:
        help: for people.
        allowed: what is shown.
        values: what the words mean, in their order, if that differs; each may be typed as well.
    """
    meaning = dict(zip(allowed, values or allowed, strict=True))

    def check(option: typer.CallbackParam, value: Any) -> Any:
        if value is not None and value not in {*allowed, *values}:
            raise unknown(option.opts[0], value, allowed)
        return meaning.get(value, value)

    def complete(incomplete: str) -> list[str]:
        return [word for word in allowed if word.startswith(incomplete)]

    return typer.Option(metavar="|".join(allowed), help=help, callback=check, autocompletion=complete)


RunNames = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="RUN", help="Folders of training runs, or names of released policies.", autocompletion=trained
    ),
]
RunName = Annotated[
    str,
    typer.Argument(
        metavar="RUN",
        help="The folder of a training run, or the name of a released policy.",
        autocompletion=trained,
    ),
]
ScenarioName = Annotated[
    str | None,
    typer.Argument(
        metavar="SCENARIO",
        help="A preset (see `uavaou scenarios`) or a YAML file.",
        autocompletion=shipped("scenarios"),
    ),
]
StudyName = Annotated[
    str,
    typer.Argument(
        metavar="STUDY", help="A study's name (paper, smoke), or a YAML file.", autocompletion=shipped("studies")
    ),
]
ScenarioOption = Annotated[str | None, option("The same as SCENARIO.", "NAME", "--scenario")]
Episodes = Annotated[int, number("Missions that each policy plays.", 1, MOST_EPISODES)]
Seed = Annotated[int, number("Mission j is seeded with N + j.", 0, LARGEST_SEED)]
Changes = Annotated[list[str] | None, option("Change scenario.FIELD. Repeatable.", "KEY=VALUE", "--set")]
Results = Annotated[Path, option("The folder of all results.", "DIR")]
Knows = Annotated[
    str,
    choice(
        "The most that a policy may know in flight: what its UAV measures, what all measure and tell by radio, or the "
        "whole simulation.",
        "local",
        "shared",
        "everything",
    ),
]
WhatIf = Annotated[
    list[str] | None, option("What happens, such as 'UAV 1 lost at half time'. Repeatable.", "TEXT", "--what-if")
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Show no progress.")]


def stated_scenario(argument: str | None, option: str | None) -> str | None:
    """The scenario of a command that takes it as SCENARIO and as ``--scenario``; None where neither is given."""
    if argument is not None and option is not None:
        raise InputError(f"SCENARIO '{argument}' and --scenario {option}: give one of them")
    return argument if option is None else option


def needed_scenario(argument: str | None, option: str | None) -> str:
    """As :func:`stated_scenario`, for a command that cannot do without one."""
    chosen = stated_scenario(argument, option)
    if chosen is None:
        raise InputError("missing argument 'SCENARIO': a preset (see uavaou scenarios) or a YAML file")
    return chosen


def refuse_scenarios(runs: Iterable[str]) -> None:
    """Refuse the scenario or map among the arguments of a command whose arguments are runs; say how it is given."""
    from uavaou.devices_csv import refuse_map
    from uavaou.zoo import zoo_names

    for name in runs:
        refuse_map(Path(name))
        if (name in zoo_names("scenarios") and not (Path(name) / "config.yaml").exists()) or Path(name).suffix in (
            ".yaml",
            ".yml",
        ):
            raise InputError(f"'{name}' is a scenario, and arguments are runs here: write --scenario {name}")


def given_path(option: str, text: str) -> Path:
    """Refuse an empty path, which would mean the present folder."""
    if not text:
        raise InputError(f"{option} is empty: expected a path")
    return Path(text)


def writable_folder(path: Path) -> None:
    """Refuse a folder that cannot be written or made; the error names the obstacle."""
    try:
        there = next(place for place in (path, *path.absolute().parents) if place.exists() or place.is_symlink())
        if not there.is_dir():
            raise InputError(f"cannot write to '{path}': '{there}' is not a folder")
        with tempfile.TemporaryFile(dir=there):  # asking for permission misses read-only file systems
            pass
    except OSError as error:
        raise InputError(f"cannot write to '{path}': {error.strerror or error}") from error


def writable_file(path: Path) -> None:
    """Refuse a file that cannot be written or replaced; the error names the obstacle."""
    if path.is_dir():
        raise InputError(f"cannot write '{path}': it is a folder")
    if path.exists() and not path.is_file():  # writing replaces the target: never a device
        raise InputError(f"cannot write '{path}': it is not a regular file")
    writable_folder(path.parent)


def available_device(device: str) -> None:
    """Refuse CUDA on a machine that has none."""
    if device != "cuda":
        return
    import torch

    if not torch.cuda.is_available():
        raise InputError("--device cuda: this machine offers no CUDA device to torch; use --device cpu or auto")
