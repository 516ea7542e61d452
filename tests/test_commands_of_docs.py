"""The commands of the pages' code blocks run one after the other, trainings with a small budget; what a comment names
is there afterwards."""

import os
import re
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import replace
from glob import glob
from pathlib import Path

import pytest
from filelock import FileLock

import uavaou.runs.train
import uavaou.runs.validation
from tests.documents import ROOT, blocks, console
from uavaou import RunConfig
from uavaou.algorithms import registry
from uavaou.experiments.suite import Suite
from uavaou.runs.validation import planner_score
from uavaou.statistics import aggregates
from uavaou_cli.main import main

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("quick_plans")]

as_asked = uavaou.runs.train.train
RUN = "results/paper/mappo/seed-0"
LESS = {  # work than the page asks for
    "eval": ["--episodes", "2"],
    "fly": ["--seconds", "1"],
    "rolling": ["--time-limit", "1"],
    "anneal": ["--time-limit", "1"],
    "route": ["--seconds", "1", "--episodes", "2"],
    "size": ["--seconds", "1"],
}
ELSEWHERE = {  # what takes longer, or needs more than a folder: the test that runs its like
    "uavaou tune": "tests/experiments",
    "uavaou study run smoke": "tests/experiments",
    "uavaou study report smoke": "tests/reports",
    "uavaou study run ours.yaml": "the test below",
    "uavaou train --continue": "tests/runs/test_start.py",
    "uavaou link": "tests/link",
    "uavaou study run paper --engine ray": "tests/experiments/test_study_killed.py",
    "uavaou plot figures results/studies/generalization": "tests/reports/test_figures.py",
    "uavaou plot figures results/studies/paper": "tests/reports/test_figures.py",
}
HOW_TO = ROOT / "docs" / "how-to"
PAGES = (
    "README",
    *(f"docs/how-to/{page.stem}" for page in sorted(HOW_TO.glob("*.md")) if page.stem != "extend"),
    "docs/tutorials/algorithm",
    "docs/tutorials/field",
    "docs/tutorials/paper",
)


def few(slots: int) -> int:
    return slots if slots < 20_000 else max(slots // 5_000, 600)  # again for a run that goes on


def small(config: RunConfig) -> RunConfig:
    """The same training with a small budget."""
    algorithm = config.algorithm
    quick = {
        "slots": few(algorithm.slots),
        "missions": 1,
        "worlds": 1,
        "rollout_slots": 50,
        "batch_rows": 50,
        "epochs": 1,
        "evaluation_missions": 1,
        "learning_starts": 20,
        "plan_slots": 10_000,
        "batch_slots": 8,
        "replay_slots": 100,
        "slots_per_update": 50,
    }
    changes = {name: value for name, value in quick.items() if name in type(algorithm).model_fields}
    budgets = tuple(map(few, config.budgets))
    return replace(config, algorithm=algorithm.model_copy(update=changes), budgets=budgets)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The results of a training of ``paper``, once for all processes of the tests; from then on, every one is small.

    So are the missions that planners are told beside it.
    """
    own = tmp_path_factory.getbasetemp()
    place = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "small-training"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(uavaou.runs.train, "train", lambda config, *rest, **more: as_asked(small(config), *rest, **more))
        patch.setattr(uavaou.runs.validation, "planner_score", lambda name, config: planner_score(name, small(config)))
        with FileLock(f"{place}.lock"):
            if not (place / "paper").exists():
                assert main(["train", "paper", "--quiet", "--out", str(place)]) == 0
        yield place


@pytest.fixture
def place(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with that training, committed results, and the files that the how-to pages tell the reader to save.

    Suites have two points, and intervals few resamples.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(aggregates, "RESAMPLES", 100)
    load = Suite.load
    monkeypatch.setattr(Suite, "load", lambda name: load(name).model_copy(update={"points": load(name).points[:2]}))
    sensors, devices = blocks(HOW_TO / "import.md", "csv")
    saved = {
        "sensors.csv": sensors,
        "sensors.geojson": (ROOT / "examples" / "field" / "sensors.geojson").read_text(encoding="utf-8"),
        "valley.csv": devices,
        "valley.yaml": blocks(HOW_TO / "import.md", "yaml")[0],
        "few.yaml": blocks(HOW_TO / "train.md", "yaml")[0],
    }
    for name, content in saved.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    shutil.copytree(trained, "results")
    for name in ("studies/paper", "studies/generalization"):
        shutil.copytree(ROOT / "results" / name, tmp_path / "results" / name)
    return tmp_path


def write_files(page: Path) -> None:
    """What the page says to save: blocks whose first line is a comment with a name, or a header; studies are small."""
    for code in (*blocks(page, "python"), *blocks(page, "yaml"), *blocks(page, "csv")):
        name = re.match(r"# (\w+\.\w+)\n", code)
        few = re.sub(r"^slots: \d+", "slots: 4000", re.sub(r"^seeds: \d+", "seeds: 1", code, flags=re.M), flags=re.M)
        Path(name[1] if name else "mine.csv").write_text(few, encoding="utf-8")


@pytest.fixture
def _registered_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a page registers is gone after its test."""
    monkeypatch.setattr(registry, "_ALGORITHMS", dict(registry._ALGORITHMS))
    monkeypatch.setattr(registry, "_PLUGINS", set(registry._PLUGINS))


@pytest.mark.usefixtures("_registered_alone")
@pytest.mark.parametrize("name", PAGES)
def test_the_commands_of_a_page(name: str, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ran, lines = 0, console(ROOT / f"{name}.md")
    if name.startswith("docs/tutorials/"):
        write_files(ROOT / f"{name}.md")
        shutil.copytree(ROOT / "examples" / "field", "examples/field")  # tutorials are read in a clone
    elif not any(line.startswith("uavaou import") for line in lines):
        lines.insert(0, console(HOW_TO / "import.md")[0])  # most pages fly the field of that page
    for line in lines:
        if name == "docs/how-to/operate" and ran == 1:
            rest = blocks(ROOT / f"{name}.md", "yaml")[0].replace("6 h", "30 min")
            Path("field/scenario.yaml").write_text(Path("field/scenario.yaml").read_text() + rest)
        if line.startswith(tuple(ELSEWHERE)):
            continue
        command, _, comment = line.replace("--duration 12h", "--duration 1h").partition("#")
        written = shlex.split(command.replace("[RUN ...]", "").replace("RUN", RUN))[1:]
        words = [found for word in written for found in sorted(glob(word)) or [word]]  # as a shell does
        code = main([*words, *(more for word in LESS if word in words for more in LESS[word])])
        err = capsys.readouterr().err
        assert code == 0, f"{line}: {err}"
        assert "Traceback" not in err
        for path in re.findall(r"results/(?:[^\s,;:]|,(?=\S))+", re.sub(r"<.*?>|\.\.\.", "*", comment)):
            assert list(place.glob(path)), line
        ran += 1
    assert ran
    if name != "docs/how-to/replay":  # tests/test_docs.py
        for code in blocks(ROOT / f"{name}.md", "python") if name.startswith("docs/how-to/") else []:
            if "onboard" not in code:  # tests/onboard
                exec(code.replace("seconds=10", "seconds=3").replace("episodes=100", "episodes=2"), {})


REFUSED = re.compile(r"^\| `(uavaou .*?)` \| `(.*?)` \|", re.MULTILINE)


@pytest.mark.parametrize("page", sorted(HOW_TO.glob("*.md")), ids=lambda page: page.stem)
def test_what_can_go_wrong_says_what_the_page_says(page: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rows of the last table: what is typed, what it says, where dots leave something out."""
    assert main(shlex.split(console(HOW_TO / "import.md")[0], comments=True)[1:]) == 0
    out = capsys.readouterr().out
    assert all(shown in out for shown in blocks(HOW_TO / "import.md", "text"))
    _, _, last = page.read_text(encoding="utf-8").partition("## What can go wrong")
    rows = REFUSED.findall(last)
    assert rows
    for typed, said in rows:
        capsys.readouterr()
        assert main(shlex.split(typed)[1:]) != 0, typed
        out, err = capsys.readouterr()
        told = " ".join((out + err).split())
        assert re.search(".*".join(map(re.escape, said.split("…"))), told), f"{typed}: {told}"


def test_a_study_writes_the_card_of_a_training_that_it_takes_over(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(uavaou.runs.train, "train", as_asked)
    page = HOW_TO / "study.md"
    study = blocks(page, "yaml")[1]
    assert "slots: 300000" in study
    assert "`uavaou train --scenario valley.yaml --slots 300000`" in page.read_text(encoding="utf-8")
    Path("ours.yaml").write_text(study.replace("300000", "8000"), encoding="utf-8")
    assert main(["train", "--scenario", "valley.yaml", "--slots", "8000", "--quiet"]) == 0
    (meta,) = place.glob("results/valley*/mappo*/seed-0/meta.json")
    before = meta.read_bytes()
    (line,) = (line for line in console(page) if "ours.yaml" in line)
    command, _, card = line.partition("# ")
    assert main([*shlex.split(command)[1:], "--quiet"]) == 0, capsys.readouterr().err
    assert Path(card).read_text(encoding="utf-8").startswith("# ")
    assert meta.read_bytes() == before  # trained nothing again
