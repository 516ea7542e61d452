"""Imports point one way and never in a circle, files stay short, and importing the package is quick."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

MOST_LINES = 400
ROOT = Path(__file__).resolve().parents[1]
# A room imports only from rooms above it in this list. `planners` sit apart: on `world` alone.
LAYERS = (
    "arrays",
    "errors",
    "threads",
    "files",
    "plain_yaml",
    "zoo",
    "units",
    "fields",
    "radio",
    "csv_tables",
    "devices_csv",
    "zones",
    "mission_fields",
    "scenario_fields",
    "draws",
    "fleet",
    "scenario",
    "family",
    "field",
    "statistics",
    "world",
    "envs",
    "algorithms",
    "evaluation",
    "runs",
    "onboard",
    "link",
    "experiments",
    "reports",
    "uavaou_cli",
)
BELOW_PLANNERS = {*LAYERS[: LAYERS.index("world") + 1], "planners"}
ABOVE_PLANNERS = {*LAYERS[LAYERS.index("evaluation") :], "planners"}


def python_files(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def module_name(path: Path) -> str:
    """The dotted name of a file of the product: ``uavaou.world.channel``; a package's own file has the package's."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(part for part in parts if part not in ("cli", "__init__"))


MODULES = {module_name(path): path for path in python_files("uavaou", "cli/uavaou_cli")}


@cache
def imports(module: str) -> frozenset[str]:
    """Everything that a file imports anywhere: at its top, in its functions, under TYPE_CHECKING.

    ``from package import module`` counts as an import of that module alone.
    """
    found: set[str] = set()
    for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import"
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= (names & MODULES.keys()) or {str(node.module)}
    return frozenset(found)


def layer(module: str) -> str:
    room, _, rest = module.partition(".")
    if rest == "__main__":  # python -m uavaou: the command line by another name
        return "uavaou_cli"
    return rest.split(".")[0] if room == "uavaou" else room


def may_import(importer: str, imported: str) -> bool:
    if "planners" in (importer, imported):
        return imported in BELOW_PLANNERS and importer in ABOVE_PLANNERS
    return LAYERS.index(imported) <= LAYERS.index(importer)


def test_imports_point_one_way() -> None:
    assert len(MODULES) > 30
    wrong = [
        f"{module} imports {name}"
        for module in MODULES.keys() - {"uavaou"}  # the public names come from every room and load on first use
        for name in imports(module)
        if name.split(".")[0] in ("uavaou", "uavaou_cli") and name != "uavaou"
        if not may_import(layer(module), layer(name))
    ]
    assert wrong == []


def circles(graph: dict[str, frozenset[str]]) -> list[list[str]]:
    """The sets of files that reach each other: Tarjan's strongly connected components of more than one file."""
    number: dict[str, int] = {}  # files in the order in which the search meets them
    lowest: dict[str, int] = {}  # the earliest open file that each one reaches
    unclosed: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        number[module] = lowest[module] = len(number)
        unclosed.append(module)
        for name in graph[module] & graph.keys():
            if name not in number:
                visit(name)
            if name in unclosed:
                lowest[module] = min(lowest[module], lowest[name])
        if lowest[module] == number[module]:
            first = unclosed.index(module)
            component = unclosed[first:]
            del unclosed[first:]
            if len(component) > 1:
                found.append(sorted(component))

    for module in graph:
        if module not in number:
            visit(module)
    return found


def test_no_files_import_each_other_in_a_circle() -> None:
    graph = {"a": {"b"}, "b": {"c", "elsewhere"}, "c": {"a"}, "d": {"a", "e"}, "e": set(), "f": {"f", "g"}, "g": {"f"}}
    frozen = {module: frozenset(names) for module, names in graph.items()}
    assert circles(frozen) == [["a", "b", "c"], ["f", "g"]]
    assert circles({module: imports(module) for module in MODULES if module != "uavaou"}) == []


def test_the_physics_knows_nothing_of_learning() -> None:
    forbidden = {"torch", "stable_baselines3", "pettingzoo", "gymnasium", "supersuit", "matplotlib"}
    world = [module for module in MODULES if layer(module) == "world"]
    assert len(world) > 5
    imported = {name.split(".")[0] for module in world for name in imports(module)}
    assert not imported & forbidden


def test_no_file_is_long() -> None:
    files = python_files("uavaou", "cli", "tests", "benchmarks", "examples")
    lines = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in files}
    assert {name: count for name, count in lines.items() if count > MOST_LINES} == {}


# What each import must leave unloaded: packages that take seconds, or code that a module promises not to share.
# One process runs them in this order, so each must leave unloaded what it names after those above it too.
LIGHT_IMPORTS = {
    "import uavaou": "torch numpy pydantic",
    "import uavaou_cli.main": "torch matplotlib scipy numpy pydantic rich yaml",
    "import uavaou.evaluation.checker": "torch uavaou.world",
    "from uavaou import Scenario, World": "torch gymnasium matplotlib",
    "import uavaou.planners": "torch ortools highspy",
    "import uavaou.experiments.study, uavaou.experiments.results, uavaou.experiments.marl_eval": "torch matplotlib",
    "from uavaou.experiments import executor; executor.outcome(b'', [], print)": "torch matplotlib",
    "import uavaou.reports.figures, uavaou.reports.mission_figures, uavaou.reports.audit": "torch",
    "import uavaou.reports.study_report": "torch",
}


@pytest.fixture(scope="module")
def loaded() -> dict[str, set[str]]:
    """The modules that are loaded after each import."""
    code = [f"import sys; sys.path[:0] = {[str(ROOT), str(ROOT / 'cli')]!r}"]
    code += [f"{statement}; print(*sys.modules)" for statement in LIGHT_IMPORTS]
    run = subprocess.run([sys.executable, "-c", "\n".join(code)], capture_output=True, text=True, check=True)
    return dict(zip(LIGHT_IMPORTS, (set(line.split()) for line in run.stdout.splitlines()), strict=True))


@pytest.mark.parametrize(("statement", "absent"), LIGHT_IMPORTS.items())
def test_nothing_heavy_is_imported_unasked(statement: str, absent: str, loaded: dict[str, set[str]]) -> None:
    assert "uavaou" in loaded[statement]
    assert not set(absent.split()) & loaded[statement]


def test_the_public_names_are_there() -> None:
    import uavaou

    for name in dir(uavaou):
        assert getattr(uavaou, name) is not None
    with pytest.raises(AttributeError, match="nothing_of_that_name"):
        uavaou.nothing_of_that_name  # noqa: B018
