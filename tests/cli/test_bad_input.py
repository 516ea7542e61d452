"""Whatever is typed or lies in a run's folder: one line, exit code 2, nothing written, no code run.

What stands in a file is bent by tests/fuzz, reader by reader.
"""

import io
import os
import pickle
import shlex
import shutil
import stat
import zipfile
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.cli.commands import TINY
from uavaou import Scenario
from uavaou_cli.main import main

pytestmark = pytest.mark.slow

words = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), min_size=1, max_size=12)
no_numbers = st.sampled_from(["x", "", " ", "1.5.2", "nan?", "0x", "--", "[1]", "1e", "²", "-" * 5000]) | words.filter(
    lambda word: not word.strip().lstrip("+-").replace("_", "").replace(".", "").replace("e", "").isalnum()
)
no_counts = no_numbers | st.sampled_from(["-1", "-99999999999999999999", "1.5", "1e-3", "inf", "nan", "9" * 5000])
KINDS = {
    "name": words.filter(lambda word: word not in ("paper", "tiny", "quickstart", "paper-table1", "mappo", "greedy")),
    "seed": no_counts,
    "count": no_counts | st.just("0"),
    "seconds": no_numbers | st.sampled_from(["0", "-1", "nan", "inf"]),
    "pause": no_numbers | st.just("-1"),
    "blocked": st.just("file"),
    "place": st.sampled_from([".", "file/x.html", "/dev/null", "/proc/x"]),
    "setting": st.sampled_from(["scenario.slots=x", "algorithm.gamma=1", "slots=3"]),
}
OPTIONS = {
    "train": "scenario:name algorithm:name seed:seed slots:count device:name backend:name out:blocked",
    "eval --policy random": "scenario:name policy:name episodes:count seed:seed action:name out:place suite:name "
    "time-limit:seconds",
    "eval --policy random --suite fading": "scenario:name episodes:count seed:seed action:name set:setting out:place",
    "plan tiny": "planner:name time-limit:seconds episodes:count seed:seed out:blocked",
    "route tiny --format csv --policy stay": "seconds:seconds policy:name seed:seed episodes:count format:name "
    "out:blocked knows:name",
    "gap tiny": "time-limit:seconds seed:seed episodes:count",
    "export nowhere --out x": "format:name",
    "replay greedy": "scenario:name seed:seed format:name slots:count time-limit:seconds out:place",
    "fly tiny": "policy:name seed:seed seconds:seconds knows:name out:blocked",
    "tune --slots 5": "trials:count jobs:count seed:seed algorithm:name space:name out:blocked",
    "tune": "seconds:seconds slots:count",
    "study run smoke": "jobs:count engine:name address:name out:blocked checkpoint-every:pause",
    "study status smoke": "out:blocked",
    "study report smoke": "out:blocked",
    "plot trajectories nowhere": "episode-seed:seed",
    "plot suite nowhere.csv": "out:blocked",
}
KEYS = st.sampled_from([f"scenario.{name}" for name in Scenario.model_fields if name not in ("name", "description")])


class Bomb:
    """What runs a command when it is unpickled."""

    def __reduce__(self) -> Any:
        return os.system, ("touch hacked",)


def files(place: Path) -> dict[str, tuple[int, int]]:
    """Every file and folder below, with its kind and size."""
    states = {str(path): path.lstat() for path in place.rglob("*")}
    return {
        name: (state.st_mode, state.st_size if stat.S_ISREG(state.st_mode) else 0) for name, state in states.items()
    }


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A working folder with a file in the way and a trained run."""
    place = tmp_path_factory.mktemp("place")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        assert main(shlex.split(f"{TINY} --algorithm mappo-paper")) == 0
        run = next(place.glob("results/*/*/seed-0"))
        assert main(["eval", str(run), "--episodes", "2", "--quiet"]) == 0
        run.rename(place / "run")
        shutil.rmtree(place / "results")
    (place / "file").write_text("in the way")
    return place


@pytest.fixture(scope="module")
def refused(place: Path) -> Iterator[Callable[..., str]]:
    """Check that a command is refused in one line and changes nothing; returns the line."""

    def check(*arguments: str) -> str:
        before = files(place)
        out, err = io.StringIO(), io.StringIO()
        with redirect_stdout(out), redirect_stderr(err):
            code = main(list(arguments))
        said = err.getvalue()
        assert (code, out.getvalue()) == (2, ""), (arguments, said)
        first, *faults = said.splitlines()
        assert first.startswith("uavaou: ")
        assert all(line.startswith("  ") for line in faults), said
        assert not faults or " faults" in first
        assert max(map(len, (first, *faults))) < 2100
        assert files(place) == before
        assert not list(place.rglob("hacked"))
        return said

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        yield check


@settings(max_examples=400)
@given(data=st.data())
def test_flags(refused: Callable[..., str], data: st.DataObject) -> None:
    command = data.draw(st.sampled_from(list(OPTIONS)))
    option, _, kind = data.draw(st.sampled_from(OPTIONS[command].split())).partition(":")
    value = data.draw(KINDS[kind])
    assume((option, value) != ("device", "auto"))  # a good one: it would train
    form = [f"--{option}={value}"] if data.draw(st.booleans()) else [f"--{option}", value]
    said = refused(*command.split(), *form)
    assert kind not in ("seed", "count", "seconds", "pause") or f"--{option}" in said


@settings(max_examples=150)
@given(
    command=st.sampled_from([*OPTIONS, "audit tiny", "scenarios", "plot figures nowhere"]),
    extra=st.sampled_from(["--sed", "--outt", "-q", "--set", "--", "extra more"]) | words.map("--{}".format),
)
def test_what_no_command_knows(refused: Callable[..., None], command: str, extra: str) -> None:
    if extra in ("--", "--help", "-h") or extra.startswith("--quiet"):
        extra = "--nothing"
    refused(*command.split(), *(extra.split(" ") if extra.startswith("extra") else [extra]), "third argument")


@settings(max_examples=200)
@given(
    key=KEYS | st.sampled_from(["algorithm.learning_rate", "algorithm.missions"]) | words,
    value=st.sampled_from(["text", "[]", "{}", "null", "nan", "-inf", "[[[", "{a:b}", "!!python/name:os.system"]),
    joint=st.sampled_from(["=", "=", "=", "", "=="]),
)
def test_settings(refused: Callable[..., None], key: str, value: str, joint: str) -> None:
    field = Scenario.model_fields.get(key.removeprefix("scenario."))
    optional = field is not None and type(None) in get_args(field.annotation)
    emptied = field is not None and value == "{}" and key.split(".")[-1] in ("links", "wind")
    assume(not (emptied or (optional and value in ("null", "[]"))))  # good ones: it would train
    refused("train", "--scenario", "tiny", "--set", f"{key}{joint}{value}")


def spoil(path: Path, how: str) -> None:
    """Put something else in a file's place."""
    content = path.read_bytes() if path.is_file() else b""
    path.unlink(missing_ok=True)
    header = b'{"policy.x":{"dtype":"F32","shape":[1000000,1000000],"data_offsets":[0,4000000000000]}}'
    written = {
        "pickle": pickle.dumps(Bomb()),
        "empty": b"",
        "header": (2**62).to_bytes(8, "little") + content[8:],
        "terabytes": len(header).to_bytes(8, "little") + header,
        "brackets": b"[" * 100_000,
        "noise": content[: len(content) // 2] + b"\xff\x00\n" + content[len(content) // 2 :],
    }
    if how == "zip":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("../../hacked", b"0" * 1_000_000)
            archive.writestr("data.pkl", pickle.dumps(Bomb()))
    elif how == "link":
        path.symlink_to("/etc/passwd")
    elif how == "pipe":
        os.mkfifo(path)
    elif how == "folder":
        path.mkdir()
    else:
        path.write_bytes(written[how])


HOW = ["pickle", "zip", "link", "pipe", "folder", "empty", "header", "terabytes", "brackets", "noise"]
READ = {
    "eval run": ["config.yaml", "checkpoints/best.safetensors"],
    "plot figures run": ["episodes.csv", "flights.csv.gz"],
}
CASES = [(command, name, how) for command, names in READ.items() for name in names for how in HOW]
CASES += [(command, "progress.csv", how) for command in READ for how in ("link", "pipe")]  # where nobody looks
OTHERS = ["eval run --suite fading --scenario tiny", "plot trajectories run", "export run --out x.zip", "gap tiny run"]
CASES += [(command, "checkpoints/best.safetensors", how) for command in OTHERS for how in ("pickle", "pipe")]


@pytest.mark.parametrize(("command", "name", "how"), CASES)
def test_run_folders(refused: Callable[..., None], place: Path, command: str, name: str, how: str) -> None:
    shutil.copytree(place / "run", place / "kept")
    try:
        spoil(place / "run" / name, how)
        refused(*command.split())
    finally:
        shutil.rmtree(place / "run")
        (place / "kept").rename(place / "run")
