"""The reference is what the code says: its examples, other tables and links; ``test_docs.py`` has its blocks."""

import doctest
import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

import uavaou
from benchmarks import pages, reference
from tests.documents import ROOT
from uavaou.algorithms import registry
from uavaou.devices_csv import _KNOWN
from uavaou.field.route_files import FORMATS
from uavaou.field.routes import fleet_routes
from uavaou.planners import PLANNERS, planner_knowledge
from uavaou.scenario import Scenario
from uavaou.scenario_fields import ScenarioFields

REFERENCE = ROOT / "docs" / "reference"


def site() -> object:
    """The hooks of the documentation site, which are in no package."""
    spec = spec_from_file_location("site_pages", ROOT / "docs" / "site" / "pages.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_examples_of_the_public_names_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").symlink_to(ROOT / "results")
    monkeypatch.setattr(registry, "_ALGORITHMS", dict(registry._ALGORITHMS))
    runner, finder = doctest.DocTestRunner(), doctest.DocTestFinder(recurse=False)
    for name in sorted(uavaou.__all__, key="load_run".__eq__):  # last: a policy is loaded once trained
        (example,) = finder.find(getattr(uavaou, name), name)
        assert example.examples, name
        assert runner.run(example).failed == 0, name


def test_what_is_added_or_changed_in_the_code_makes_the_page_stale(monkeypatch: pytest.MonkeyPatch) -> None:
    fields = reference.of_class(ScenarioFields)
    assert set(ScenarioFields.model_fields) <= {name for name, text in fields.items() if text}
    monkeypatch.setattr("sys.argv", ["pages", "--check"])
    monkeypatch.setattr(pages, "PAGES", ("docs/reference/planners.md",))
    assert pages.main() == 0
    monkeypatch.setitem(PLANNERS, "mine", "uavaou.planners.base:Stay")
    assert pages.main() == 1


def test_every_planner_says_what_it_knows() -> None:
    rows = re.findall(
        r"^\| `([\w-]+)` \| [^|]+ \| (\w+) \|", (REFERENCE / "planners.md").read_text(encoding="utf-8"), re.M
    )
    known = dict(rows)
    assert {name: known[name] for name in PLANNERS} == {name: planner_knowledge(name) for name in PLANNERS}


def test_the_columns_of_devices_and_routes_stand_on_the_page() -> None:
    page = (REFERENCE / "files.md").read_text(encoding="utf-8")
    routes = page[page.index("column of `csv`") : page.index("## Plan")]
    assert {*_KNOWN, "name"} <= set(re.findall(r"`(\w+)`", page[: page.index("## Field")]))
    scenario = Scenario.load("tiny").replace(georeference={"latitude": 46, "longitude": 7})
    route, *_ = fleet_routes(scenario, np.array([scenario.cds_cells] * scenario.slots))
    columns = set(FORMATS["csv"][1](route).partition("\n")[0].split(","))
    assert columns == set(re.findall(r"`(\w+)`", routes)) - {"csv", "georeference"}


def test_the_first_use_of_a_term_leads_to_the_glossary() -> None:
    hooks = site()
    assert len(hooks.TERMS) <= 25
    kept = "# A mission\n\n`slot` [a slot](x.md) <!-- slot -->\n\n```\nmission\n```\n\n"
    done = hooks.with_terms(f"{kept}Policies of UAVs plan a Slot, one slot.", "g.md")
    line = "[Policies](g.md#policy) of [UAVs](g.md#uav) [plan](g.md#plan) a [Slot](g.md#slot), one slot."
    assert done == kept + line
