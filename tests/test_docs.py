"""What the pages name exists, their examples run, and their numbers are those of the committed tables."""

import re
import tomllib
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
import typer.main
from PIL import Image
from stable_baselines3 import PPO

from benchmarks import pages as written
from tests.documents import PAGES, ROOT, SITE, blocks, code_spans, commands, parse
from uavaou import Family, Scenario, flatten
from uavaou.algorithms.registry import ENTRY_POINTS
from uavaou.reports import markdown
from uavaou_cli.main import app

DOCS = ROOT / "docs"
HOW_TO = DOCS / "how-to"
pages = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub forms them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pages
def test_links_resolve(page: Path) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
        if target.startswith("https://"):
            continue
        path, _, anchor = target.partition("#")
        found = page.parent / unquote(path) if path else page
        assert found.exists(), target
        assert not anchor or anchor in anchors(found), target


@pages
def test_files_that_it_names_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"(?<![\w./])(?:uavaou|cli|tests|benchmarks|examples|zoo_configs)/[\w./-]*\w", text):
        assert (ROOT / name).exists(), name
    for name in code_spans(page):  # `world/flight.py`: below uavaou/
        if re.fullmatch(r"[a-z_]+/[a-z_/]+\.py", name):
            assert (ROOT / name).exists() or (ROOT / "uavaou" / name).exists(), name


@pages
def test_dotted_names_that_it_gives_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"python -m (benchmarks[.\w]*)", text):
        assert find_spec(name) is not None, name
    for name in set(re.findall(r"(?<![\w.])uavaou(?:\.[A-Za-z_]\w*)+", text)):
        parts = name.split(".")
        modules = [".".join(parts[:k]) for k in range(1, len(parts) + 1)]
        module = modules[0]
        for longer in modules[1:]:
            if hasattr(import_module(module), "__path__") and find_spec(longer) is not None:
                module = longer
        found: object = import_module(module)
        for attribute in parts[len(module.split(".")) :]:
            assert hasattr(found, attribute), name
            found = getattr(found, attribute)


@pages
def test_it_installs_from_the_clone(page: Path) -> None:
    """The package is not published; what the program says, and so the blocks, holds where it is installed."""
    assert not re.search(r"uavaou\[\w|install uavaou", markdown.BLOCK.sub("", page.read_text(encoding="utf-8")))


@pages
def test_uavaou_exports_what_it_imports(page: Path) -> None:
    import uavaou

    for code in blocks(page, "python"):
        for names in re.findall(r"^from uavaou import (.*)$", code, flags=re.MULTILINE):
            for name in names.split(", "):
                assert hasattr(uavaou, name), name


@pages
def test_commands_can_be_parsed(page: Path) -> None:
    root = typer.main.get_command(app)
    for arguments in commands(page):
        if arguments[0] not in ("COMMAND", "--version", "--help", "--install-completion"):  # these would be run
            parse(root, ["7" if word in ("N", "S") else word for word in arguments])


@pages
def test_code_is_python_and_pictures_have_a_text(page: Path) -> None:
    for code in [*blocks(page, "python"), *blocks(page, "py")]:
        compile(code, str(page), "exec")
    for text in re.findall(r"!\[([^\]]*)\]\(", page.read_text(encoding="utf-8")):
        assert len(text.split()) > 3, text  # says what is seen


def test_the_site_has_every_page_and_every_public_name() -> None:
    import uavaou

    listed = re.findall(r": (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert {str(page.relative_to(ROOT)) for page in SITE} <= set(listed)
    assert all((ROOT / name).is_file() for name in listed)
    described = re.findall(
        r"^::: [\w.]+\.(\w+)$", (DOCS / "reference" / "api.md").read_text(encoding="utf-8"), flags=re.MULTILINE
    )
    assert sorted(described) == sorted(uavaou.__all__)


def test_the_citation_states_this_version_and_architecture_every_room() -> None:
    import uavaou

    assert f"version: {uavaou.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    text = (DOCS / "explanation" / "architecture.md").read_text(encoding="utf-8")
    for room in (ROOT / "uavaou").iterdir():
        if (room / "__init__.py").is_file():
            assert f"  {room.name}/" in text, room.name


def test_a_scenario_of_your_own(tmp_path: Path) -> None:
    page = HOW_TO / "import.md"
    (tmp_path / "valley.yaml").write_text(blocks(page, "yaml")[0], encoding="utf-8")
    table = blocks(page, "csv")[1]
    (tmp_path / "valley.csv").write_text(table, encoding="utf-8")
    valley = Scenario.load(tmp_path / "valley.yaml")
    assert valley.devices == len(table.strip().splitlines()) - 1
    assert valley.name == "valley"


def test_reading_a_study(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(ROOT)
    for code in blocks(HOW_TO / "study.md", "python"):
        exec(code, {})
    assert "17.5" in capsys.readouterr().out


def test_a_study_and_a_suite_of_your_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from uavaou.experiments.study import Study
    from uavaou.experiments.suite import Suite

    monkeypatch.chdir(tmp_path)  # where the scenario of the second study lies
    (tmp_path / "valley.yaml").write_text("base: quickstart\n", encoding="utf-8")
    study, ours, *_ = blocks(HOW_TO / "study.md", "yaml")
    (batteries,) = blocks(HOW_TO / "evaluate.md", "yaml")
    for name, kind, content in (("study", Study, study), ("ours", Study, ours), ("batteries", Suite, batteries)):
        (tmp_path / f"{name}.yaml").write_text(content, encoding="utf-8")
        assert kind.load(tmp_path / f"{name}.yaml").name == name


def test_a_search_space_of_your_own(tmp_path: Path) -> None:
    import yaml

    from uavaou.experiments.search import Search
    from uavaou.experiments.search_space import SearchSpace

    *_, space, search = blocks(HOW_TO / "study.md", "yaml")
    assert len(SearchSpace.from_dict(yaml.safe_load(space), "study.md").dimensions) == 3
    (tmp_path / "own.yaml").write_text(search, encoding="utf-8")
    assert Search.load(tmp_path / "own.yaml").trainings == 2 * (16 + 3 * 2 * 3)


def test_a_family_of_your_own(tmp_path: Path) -> None:
    (few,) = (code for code in blocks(HOW_TO / "train.md", "yaml") if code.startswith("# few.yaml"))
    (tmp_path / "few.yaml").write_text(few, encoding="utf-8")
    draws = [Family.load(tmp_path / "few.yaml").draw(number) for number in range(60)]
    assert {draw.uavs for draw in draws} == {1, 2, 3, 4}
    assert all(draw.layout == "resample" and 5 <= draw.devices <= 60 for draw in draws)
    base = Scenario.load("paper").replace(layout="resample")
    own = [draw.replace(name=base.name, description=base.description) == base for draw in draws]
    assert 0.15 < sum(own) / len(own) < 0.45


@pytest.mark.slow
def test_stock_ppo_in_the_page_of_learners() -> None:
    (code,) = (code for code in blocks(HOW_TO / "extend.md", "python") if "model = PPO(" in code)
    names: dict[str, Any] = {}
    exec(code.replace("missions=16", "missions=1").replace("100_000", "100"), names)
    assert type(names["model"]) is PPO
    assert names["model"]._n_updates == names["model"].n_epochs


def test_a_learner_on_an_environment_of_your_own() -> None:
    (code,) = (code for code in blocks(HOW_TO / "extend.md", "python") if "model = QMIX(" in code)
    assert "learn(200_000)" in code
    env = flatten("tiny", missions=2, seed=0)
    names: dict[str, Any] = {"vec_env": env, "rows": env.reset()}
    exec(code.replace("200_000", "200"), names)
    model, actions = names["model"], names["actions"]
    assert 200 <= model.num_timesteps < 200 + env.num_envs * env.scenario.slots  # agent steps
    local = names["rows"][:, : env.row_layout.local_size]
    np.testing.assert_array_equal(model.predict(local, deterministic=True)[0], actions)


def test_own_algorithms_are_the_example_and_have_an_entry_point() -> None:
    (table,) = blocks(HOW_TO / "extend.md", "toml")
    assert list(tomllib.loads(table)["project"]["entry-points"]) == [ENTRY_POINTS]
    code, *_ = blocks(HOW_TO / "extend.md", "python")
    assert code in (ROOT / "examples" / "plain_ppo.py").read_text(encoding="utf-8")


def test_a_planner_of_your_own(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = (code for code in blocks(HOW_TO / "extend.md", "python") if "class Oldest" in code)
    exec(code, {})
    assert 0 < float(capsys.readouterr().out) < 1000


def test_frames_from_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (code,) = blocks(HOW_TO / "replay.md", "python")
    assert code.count("60") == 2
    exec(code.replace("60", "2").replace("slot-2", "slot"), {})
    assert Image.open("slot.png").size == (640, 576)
    assert Image.open("mission.gif").n_frames == 3


RUNNING = {
    "README.md": "## Does MAPPO win?",
    "results/README.md": "# Results",
}  # pages whose text has no numbers from there on
WRITTEN = r"<!-- numbers:.*?<!-- /numbers -->|```.*?```|`[^`]*`|\]\([^)]*\)"


@pytest.mark.parametrize("page", written.PAGES)
def test_the_blocks_are_those_of_the_tables(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    assert markdown.filled(text, written.BLOCKS) == text


def test_every_block_stands_on_a_page() -> None:
    text = "".join((ROOT / page).read_text(encoding="utf-8") for page in written.PAGES)
    assert {name for _, name, _ in markdown.BLOCK.findall(text)} == {*written.BLOCKS, "claims:paper"}


@pytest.mark.parametrize("page", RUNNING)
def test_running_text_has_no_numbers(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    plain = re.sub(WRITTEN, "", text[text.index(RUNNING[page]) :], flags=re.DOTALL)
    found = [line for line in plain.splitlines() if re.search(r"\d", re.sub(r"95 %|Fig\. \d|Figures? \d", "", line))]
    assert found == []


def test_a_number_that_is_not_of_the_tables_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    held = (ROOT / "README.md").read_text(encoding="utf-8")
    (tmp_path / "README.md").write_text(
        held.replace("| QMIX from nothing | ", "| QMIX from nothing | 1"), encoding="utf-8"
    )
    monkeypatch.setattr(written, "PAGES", ("README.md",))
    (tmp_path / "results").symlink_to(ROOT / "results")
    monkeypatch.setattr(written, "ROOT", tmp_path)
    monkeypatch.setattr("sys.argv", ["pages", "--check"])
    assert written.main() == 1
    assert "make results" in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", ["pages"])
    assert written.main() == 0
    assert (tmp_path / "README.md").read_text(encoding="utf-8") == held
