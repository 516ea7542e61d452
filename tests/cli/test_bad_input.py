"""Whatever is typed or lies on the disk: one line, exit code 2, nothing written, no code run."""

from __future__ import annotations

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
from typing import Any

import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from uavaou import Scenario
from uavaou_cli.main import main

TRAIN = (
    "train --scenario tiny --quiet --slots 96 --set algorithm.missions=8 --set algorithm.rollout_slots=12 "
    "--set algorithm.batch_rows=240 --set algorithm.evaluation_missions=2 --set algorithm.hidden=[8]"
)

words = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), min_size=1, max_size=12)
no_numbers = st.sampled_from(["x", "", " ", "1.5.2", "nan?", "0x", "--", "[1]", "1e", "²", "-" * 5000]) | words.filter(
    lambda word: not word.strip().lstrip("+-").replace("_", "").replace(".", "").replace("e", "").isalnum()
)
no_counts = no_numbers | st.sampled_from(["-1", "-99999999999999999999", "1.5", "1e-3", "inf", "nan", "9" * 5000])
no_names = words.filter(lambda word: word not in ("paper", "tiny", "quickstart", "paper-table1", "mappo", "greedy"))

OPTIONS: dict[str, dict[str, st.SearchStrategy[str]]] = {
    "train": {
        "--scenario": no_names, "--algorithm": no_names, "--seed": no_counts, "--slots": no_counts | st.just("0"),
        "--device": no_names, "--backend": no_names, "--checkpoint-every": no_numbers | st.just("0"),
        "--out": st.just("file"),
    },
    "eval --policy random": {
        "--scenario": no_names, "--policy": no_names, "--episodes": no_counts | st.just("0"), "--seed": no_counts,
        "--action": no_names, "--out": st.sampled_from([".", "file/x", "/dev/null", "/proc/x"]),
        "--suite": no_names, "--time-limit": no_numbers | st.sampled_from(["0", "-1", "nan", "inf", "5"]),
    },
    "eval --policy random --suite fading": {
        "--scenario": no_names, "--episodes": no_counts | st.just("0"), "--seed": no_counts, "--action": no_names,
        "--set": st.sampled_from(["scenario.slots=x", "algorithm.gamma=1", "slots=3"]),
        "--out": st.sampled_from([".", "file/x", "/dev/null", "/proc/x"]),
    },
    "plan tiny": {
        "--planner": no_names, "--time-limit": no_numbers | st.sampled_from(["0", "-1", "nan", "inf"]),
        "--episodes": no_counts | st.just("0"), "--seed": no_counts, "--out": st.just("file"),
    },
    "route tiny --format csv --policy stay": {
        "--seconds": no_numbers | st.sampled_from(["0", "-1", "nan", "inf"]), "--policy": no_names, "--seed": no_counts,
        "--episodes": no_counts | st.just("0"), "--format": no_names, "--out": st.just("file"), "--knows": no_names,
    },
    "gap tiny": {
        "--time-limit": no_numbers | st.sampled_from(["0", "-1", "nan", "inf"]), "--seed": no_counts,
        "--episodes": no_counts,
    },
    "export nowhere --out x": {"--format": no_names},
    "replay greedy": {
        "--scenario": no_names, "--seed": no_counts, "--format": no_names, "--time-limit": st.just("5"),
        "--out": st.sampled_from([".", "file/x.html", "x.png", "x", "/dev/null"]),
    },
    "study run smoke": {
        "--jobs": no_counts | st.just("0"), "--engine": no_names, "--address": no_names, "--out": st.just("file"),
        "--checkpoint-every": no_numbers | st.just("-1"),
    },
    "study status smoke": {"--out": st.just("file")},
    "study report smoke": {"--out": st.just("file")},
    "plot trajectories nowhere": {"--episode-seed": no_counts},
    "plot suite nowhere.csv": {"--out": st.just("file")},
}  # fmt: skip

NUMBERS = [
    "area_x_m", "grid_step_m", "uavs", "devices", "slots", "slot_length_s", "speed_m_s", "altitudes_m", "cds_m",
    "flight_time_budget_s", "rician_factor", "noise_power_dbm", "rate_min_bit_s", "bandwidth_hz", "transmit_power_mw",
    "update_period_slots", "layout_seed",
]  # fmt: skip
NONSENSE: list[Any] = [
    "text", "", [], {}, None, True, float("nan"), float("inf"), "1e5x", [[[]]], {"a": "b"}, {"low": 3}, -(10**40),
    10**400,
]  # fmt: skip
BROKEN_YAML = [
    "{", "a: b: c", "\t- x", "- paper", "", "null", "42", "%", "a: &a [*a]", "? x", "base: nothing", "base: [tiny]",
    "base: tiny\n1: 2", "base: tiny\ndevices_csv: ../../../etc/passwd", "base: tiny\ndevices_csv: 3", "[" * 5000,
    "base: !!python/object/apply:os.system ['touch hacked']", "!!python/object/new:os.system ['touch hacked']",
    "base: tiny\nslots: !!python/name:os.system", "base: tiny\nslots: " + "9" * 5000,
    "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\nbase: tiny",
]  # fmt: skip
KEYS = st.sampled_from([f"scenario.{name}" for name in NUMBERS] + ["algorithm.learning_rate", "algorithm.missions"])
SUITE_FIELDS = ["description", "scenario", "axis", "points", "name", "?"]
SCENARIO_COMMANDS = ["audit {}", "train --scenario {}", "eval --policy random --scenario {}", "plan {}", "gap {}"]


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
        assert main(shlex.split(TRAIN)) == 0
        run = next(place.glob("results/*/*/seed-0"))
        assert main(["eval", str(run), "--episodes", "2", "--quiet"]) == 0
        run.rename(place / "run")
        shutil.rmtree(place / "results")
    (place / "file").write_text("in the way")
    return place


@pytest.fixture(scope="module")
def refused(place: Path) -> Iterator[Callable[..., None]]:
    """Check that a command is refused in one line and changes nothing."""

    def check(*arguments: str) -> None:
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

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        yield check


@pytest.mark.slow
@settings(max_examples=800)
@given(data=st.data())
def test_flags(refused: Callable[..., None], data: st.DataObject) -> None:
    command = data.draw(st.sampled_from(list(OPTIONS)))
    option = data.draw(st.sampled_from(list(OPTIONS[command])))
    value = data.draw(OPTIONS[command][option])
    assume((option, value) != ("--device", "auto"))  # a good one: it would train
    form = [f"{option}={value}"] if data.draw(st.booleans()) else [option, value]
    refused(*command.split(), *form)


@pytest.mark.slow
def test_a_value_of_any_length_is_refused_in_a_short_line(refused: Callable[..., None]) -> None:
    refused("train", "--slots", "-" * 5000)


@pytest.mark.slow
@settings(max_examples=300)
@given(
    command=st.sampled_from([*OPTIONS, "audit tiny", "scenarios", "plot figures nowhere"]),
    extra=st.sampled_from(["--sed", "--outt", "-q", "--set", "--", "extra more"]) | words.map("--{}".format),
)
def test_what_no_command_knows(refused: Callable[..., None], command: str, extra: str) -> None:
    if extra in ("--", "--help", "-h") or extra.startswith("--quiet"):
        extra = "--nothing"
    refused(*command.split(), *(extra.split(" ") if extra.startswith("extra") else [extra]), "third argument")


@pytest.mark.slow
@settings(max_examples=400)
@given(
    key=KEYS | words,
    value=st.sampled_from(
        ["text", "[]", "{}", "null", "true", "nan", "-inf", "[[[", "{a: b}", "!!python/name:os.system"]
    ),
    joint=st.sampled_from(["=", "=", "=", "", "=="]),
)
def test_settings(refused: Callable[..., None], key: str, value: str, joint: str) -> None:
    refused("train", "--scenario", "tiny", "--set", f"{key}{joint}{value}")


@pytest.mark.slow
@settings(max_examples=500)
@given(
    command=st.sampled_from(SCENARIO_COMMANDS),
    field=st.sampled_from([*NUMBERS, "slot", "device", "?"]),
    value=st.sampled_from(NONSENSE),
    cut=st.none() | st.integers(1, 60),
)
def test_scenario_files(
    refused: Callable[..., None], place: Path, command: str, field: str, value: Any, cut: int | None
) -> None:
    fields = Scenario.load("tiny").to_dict() | {field: value}
    text = yaml.safe_dump(fields, sort_keys=False)
    if cut is not None:  # in the middle of the fields: some that are needed are missing
        text = text[: len(text) * cut // 100]
    (place / "scenario.yaml").write_text(text)
    refused(*command.format("scenario.yaml").split())


@pytest.mark.slow
@pytest.mark.parametrize("command", [*SCENARIO_COMMANDS, "eval --suite {}", "study run {}"])
@pytest.mark.parametrize("text", BROKEN_YAML, ids=range(len(BROKEN_YAML)))
def test_files_that_are_none(refused: Callable[..., None], place: Path, command: str, text: str) -> None:
    (place / "broken.yaml").write_text(text)
    refused(*command.format("broken.yaml").split())


@pytest.mark.slow
@settings(max_examples=200)
@given(field=st.sampled_from(SUITE_FIELDS), value=st.sampled_from(NONSENSE), inside=st.booleans())
def test_suite_files(refused: Callable[..., None], place: Path, field: str, value: Any, inside: bool) -> None:
    content: dict[str, Any] = {"description": "d", "scenario": "tiny", "axis": {"label": "x"}}
    content["points"] = [{"label": "a", "x": 0, "set": {"slots": 12}}]
    if inside:  # a point has none of the other fields
        content["points"][0] |= {field if field not in ("points", "axis") else "set": value if value != {} else []}
    elif field == "description" and isinstance(value, str) and value:  # any words will do
        content["axis"] = value
    else:
        content[field] = value
    (place / "suite.yaml").write_text(yaml.safe_dump(content))
    refused("eval", "--policy", "stay", "--quiet", "--suite", "suite.yaml")


STUDY = {"seeds": 1, "scenarios": ["tiny"], "variants": {"mappo": {}}, "planners": ["greedy"], "episodes": 2}


@pytest.mark.slow
@settings(max_examples=300)
@given(
    command=st.sampled_from(["run", "status", "report"]),
    field=st.sampled_from([*STUDY, "slots", "bound", "planning_seconds", "description", "sedes"]),
    value=st.sampled_from(NONSENSE),
    cut=st.none() | st.integers(1, 35),
)
def test_study_files(
    refused: Callable[..., None], place: Path, command: str, field: str, value: Any, cut: int | None
) -> None:
    harmless = {"description": ("text", "", "1e5x"), "planners": ([],), "bound": (True,), "seeds": ()}
    if value in harmless.get(field, ()) and type(value) in (str, list, bool):
        value = None
    text = yaml.safe_dump(STUDY | {field: value}, sort_keys=False)
    if cut is not None:  # before the variants
        text = text[:cut]
    (place / "study.yaml").write_text(text)
    refused("study", command, "study.yaml")


POLICY_COMMANDS = [
    "eval run",
    "eval run --suite fading --scenario tiny",
    "plot trajectories run",
    "export run --out x.safetensors",
    "gap tiny run",
]


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
READ = {command: ["config.yaml", "checkpoints/best.safetensors"] for command in POLICY_COMMANDS}
READ["plot figures run"] = ["config.yaml", "episodes.csv", "flights.csv.gz"]
CASES = [(command, name, how) for command, names in READ.items() for name in names for how in HOW]
CASES += [(command, "progress.csv", how) for command in READ for how in ("link", "pipe")]  # where nobody looks


@pytest.mark.slow
@pytest.mark.parametrize(("command", "name", "how"), CASES)
def test_run_folders(refused: Callable[..., None], place: Path, command: str, name: str, how: str) -> None:
    shutil.copytree(place / "run", place / "kept")
    try:
        spoil(place / "run" / name, how)
        refused(*command.split())
    finally:
        shutil.rmtree(place / "run")
        (place / "kept").rename(place / "run")


@pytest.mark.slow
@settings(max_examples=250)
@given(
    command=st.sampled_from(list(READ)),
    part=st.sampled_from(["scenario", "algorithm", None]),
    field=st.sampled_from(
        ["slots", "devices", "uavs", "missions", "hidden", "name", "learning_rate", "seed", "schema"]
    ),
    value=st.sampled_from(
        [v for v in NONSENSE if v != 10**400] + [[65_536] * 16, [-1], "../../x", "a/b", {"hidden": 3}]
    ),
)
def test_run_configurations(
    refused: Callable[..., None], place: Path, command: str, part: str | None, field: str, value: Any
) -> None:
    config = place / "run" / "config.yaml"
    kept = config.read_text()
    content = yaml.safe_load(kept)
    inside = content if part is None else content[part]
    if part is None or field not in inside:
        field = {"scenario": "devices", "algorithm": "hidden", None: "schema"}[part]
    if (part, field) == ("scenario", "name"):
        field = "devices"
    inside[field] = value
    config.write_text(yaml.safe_dump(content))
    try:
        refused(*command.split())
    finally:
        config.write_text(kept)
