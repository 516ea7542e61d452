"""What a suite's file may say, the suites that are shipped, and the figure of one."""

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.cli.commands import Shell
from tests.experiments.small import GOOD, POINT
from uavaou import InputError, Scenario
from uavaou.csv_tables import write_table
from uavaou.errors import InfeasibleError
from uavaou.evaluation.flights import Flights
from uavaou.experiments.suite import Suite, resolve_points
from uavaou.experiments.suite_flights import plan_suite
from uavaou.planners import make_planner
from uavaou.reports import style
from uavaou.reports.suites import SuiteTable, plot_suite, read_suites
from uavaou.runs.names import name_with
from uavaou.zoo import zoo_names


@pytest.mark.slow
@pytest.mark.parametrize("name", zoo_names("suites"))
def test_all_points_of_shipped_suites_are_feasible(name: str) -> None:
    suite = Suite.load(name)
    resolved = resolve_points(suite, Scenario.load(suite.scenario))
    assert all(point.scenario is not None for point in resolved)
    assert [point.x for point in suite.points] == sorted({point.x for point in suite.points})


def test_shipped_suites_are_those_of_the_docs() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "evaluate.md").read_text(encoding="utf-8")
    names = zoo_names("suites")
    assert " ".join(names) == "areas devices fading known-layouts layouts observation paper rate uavs unseen-layouts"
    assert all(f"| `{name}` |" in page for name in names)


def test_shipped_suites_contain_the_papers_scenario_new_layouts_and_fading_in_decibels() -> None:
    suite = Suite.load("fading")
    for point in suite.points:
        if point.label != "none":
            assert 10 * np.log10(point.set["rician_factor"]) == pytest.approx(point.x, abs=1e-9)
    assert suite.points[-1].set == {"fading": "none"}
    paper = Scenario.load("paper")
    for name, label in (("uavs", "3"), ("devices", "25"), ("fading", "10"), ("rate", "150")):
        scenarios = {point.label: point.scenario for point in resolve_points(Suite.load(name), paper)}
        assert scenarios[label] == paper
    seeds = {place.scenario.layout_seed for place in resolve_points(Suite.load("layouts"), paper) if place.scenario}
    assert len(seeds) == 10
    assert min(seeds) > 9
    assert [point.label for point in Suite.load("fading").points if not point.joined] == ["none"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"axes": {"label": "x"}}, "unknown field 'axes'; did you mean 'axis'"),
        ({"axis": {"label": "x", "scale": "logarithmic"}}, "axis: scale = 'logarithmic'"),
        ({"axis": {"label": "x", "unti": "dB"}}, "axis: unknown field 'unti'; did you mean 'unit'"),
        ({"axis": "x"}, "axis = 'x': expected a mapping"),
        ({"points": []}, r"^own.yaml: points = \[\]: expected a list of at least one, such as - {label: "),
        ({"points": POINT}, "points = {'label': 'a', 'x': 1}: expected a list of at least one"),
        ({"points": None}, "points = None: expected a list of at least one"),
        ({"points": [POINT, POINT]}, "two are labelled 'a'"),
        ({"points": ["a"]}, r"points\[0\] = 'a': expected a mapping"),
        ({"points": [POINT, {"label": "b"}]}, r"points\[1\]: the field x is missing"),
        ({"points": [{"label": "a", "x": "1"}]}, "expected a number"),
        ({"points": [POINT | {"sets": {}}]}, r"points\[0\]: unknown field 'sets'; did you mean 'set'"),
        ({"points": [POINT | {"set": {"device": 3}}]}, "no 'device'; did you mean 'devices'"),
        ({"points": [POINT | {"observation": "shard"}]}, r"points\[0\]: observation = 'shard'"),
        ({"name": "other"}, "a suite has the name of its file"),
        ({"points": [{"labl": "a", "x": 1}]}, r"points\[0\]: unknown field 'labl'; did you mean 'label'"),
        ({"points": [{"label": 500, "x": 1}]}, r"points\[0\]: label = 500: expected text, in quotes$"),
        ({"points": [{"label": "", "x": 1}]}, r"points\[0\]: label = '': must not be empty$"),
        ({"points": [POINT | {"set": ["devices"]}]}, r"set = \['devices'\]: expected a mapping, such as"),
        ({"points": [POINT | {"set": {3: 4}}]}, "the scenario has no '3'"),
        ({"points": [POINT | {"set": {"name": "b"}}]}, "a point cannot change a scenario's name"),
        ({"points": [POINT | {"set": {"observation": "local"}}]}, "write it beside set, not in it"),
        ({"points": [POINT | {"observation": "shard"}]}, "did you mean 'shared'"),
        ({"points": [POINT | {"joined": "no"}]}, r"points\[0\]: joined = 'no'"),
        ({"points": [POINT | {"label": str(k)} for k in range(1001)]}, "expected at most 1,000 values$"),
        ({"axis": {"label": "x", "scale": "log"}, "points": [POINT | {"x": 0}]}, "'a' has x = 0, not above 0"),
    ],
)
def test_schema_errors_name_the_field(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Suite.from_dict(GOOD | changes, "own", "own.yaml")


def test_an_invalid_change_is_an_error_and_an_infeasible_one_has_a_class() -> None:
    suite = Suite.from_dict(GOOD | {"points": [POINT | {"set": {"slots": "many"}}]}, "own", "own.yaml")
    with pytest.raises(InputError, match="suite 'own', point 'a': scenario 'tiny': slots = 'many'"):
        resolve_points(suite, Scenario.load("tiny"))
    tiny = Scenario.load("tiny")
    for changes in ({"cds_m": [[50, 0], [0, 0]]}, {"flight_time_budget_s": 1}):
        with pytest.raises(InfeasibleError, match="breaks constraint"):
            tiny.replace(**changes)
    with pytest.raises(InputError) as found:
        tiny.replace(slots="x")
    assert not isinstance(found.value, InfeasibleError)


def test_points_without_a_link_name_the_constraint() -> None:
    tiny = Scenario.load("tiny")
    points = [{"label": str(rate), "x": rate, "set": {"rate_min_bit_s": rate}} for rate in (150_000, 10_000_000)]
    near, far = resolve_points(Suite.from_dict(GOOD | {"points": points}, "own", "own.yaml"), tiny)
    assert near.scenario is not None
    assert not near.remark
    assert far.scenario is None
    assert far.problem.startswith("no device can be served: R_min = 10000 kbit/s")
    assert "constraint Rate" in far.problem
    # One device with a weak radio of its own: the point is played, and the device told of.
    partly = [{"label": "a", "x": 1, "set": {"transmit_power_mw": [0.3, 0.3, 0.3, 1e-9]}}]
    (place,) = resolve_points(Suite.from_dict(GOOD | {"points": partly}, "own", "own.yaml"), tiny)
    assert place.scenario is not None
    assert place.remark.startswith("1 of 4 devices can never be served")


def test_a_suite_is_named_with_its_changes_and_a_folder_is_none(tmp_path: Path) -> None:
    assert name_with("fading", {}) == "fading"
    assert name_with("fading", {"scenario": "tiny", "area_x_m": "1/2"}) == "fading+area_x_m=1%2F2,scenario=tiny"
    assert len(name_with("fading", {"cds_m": "[" * 300})) < 200
    with pytest.raises(InputError, match=r"unknown suite .*suites: areas, devices, fading"):
        Suite.load(str(tmp_path))


def rows(policy: str, how: str, point: str, x: float, *ages: float, **more: Any) -> Flights:
    """The missions of a policy at a point of a suite."""
    same = {"suite": "s", "axis": "x (m)", "scale": "linear", "joined": "yes"}
    who = {"policy": policy, "how": how, "point": point, "x": x}
    missions = {"mission_seed": np.arange(len(ages)), "mean_aou_slots": np.array(ages)}
    return Flights.of(same | who | missions | more)


def written(path: Path, *parts: Flights) -> Path:
    write_table(path, Flights.joined(parts).flights)
    return path


def read(path: Path) -> SuiteTable:
    (table,) = read_suites([path])
    return table


def test_a_table_is_drawn(shell: Shell, place: Path) -> None:
    shell("eval run --policy greedy --suite own.yaml --episodes 3 --quiet --out results/suites/own.csv.gz")
    code, out, _ = shell("plot suite")
    assert code == 0
    assert out.split() == ["results/suites/suite-own.png", "results/suites/suite-own.pdf"]
    assert (place / "results" / "suites" / "suite-own.pdf").read_bytes().startswith(b"%PDF")
    table = read(place / "results" / "suites" / "own.csv.gz")
    assert list(table.points.values()) == sorted(table.points.values())


@pytest.mark.parametrize("scale", ["linear", "log", "category"])
def test_seeds_and_single_missions_are_drawn(tmp_path: Path, scale: str) -> None:
    learned = [
        rows("mappo", how, str(x), x, x + seed, seed=seed, slots=9, scale=scale)
        for x, how in ((1, "trained"), (30, "zero-shot"))
        for seed in (0, 1)
    ]
    table = written(tmp_path / "s.csv", *learned, rows("greedy", "planner", "none", 40, 0, scale=scale))
    assert all(path.stat().st_size > 5000 for path in plot_suite(read(table), tmp_path))


def drawn(monkeypatch: pytest.MonkeyPatch, table: Path) -> Any:
    """The figure of a table, as it is saved."""
    figures: list[Any] = []
    monkeypatch.setattr(style, "save", lambda figure, *_: figures.append(figure) or [])
    plot_suite(read(table), table.parent)
    return figures[0]


@pytest.mark.parametrize("scale", ["linear", "log", "category"])
def test_lines_join_all_points_but_marked_ones(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, scale: str) -> None:
    points = [
        {"label": "250 slots", "x": 250, "set": {"speed_m_s": 20}},
        {"label": "500 slots", "x": 500},
        {"label": "900", "x": 900, "joined": False},
    ]
    axis = {"label": "budget", "scale": scale}
    suite = Suite.from_dict(GOOD | {"axis": axis, "points": points}, "own", "own.yaml")
    flights = plan_suite(suite, {}, ["stay"], "tiny", Scenario.load("tiny"))
    silent = SimpleNamespace(start=lambda name: None, after_slot=lambda slots, world: None)
    flights.play({"stay": make_planner("stay")}, 1, 0, silent)
    assert flights.table["joined"].tolist() == ["yes", "yes", "no"]
    write_table(tmp_path / "s.csv", flights.table)
    (axes,) = drawn(monkeypatch, tmp_path / "s.csv").axes
    lines = [list(line.get_xdata()) for line in axes.lines if len(line.get_xdata()) > 1]
    assert lines == ([] if scale == "category" else [[250.0, 500.0]])


@pytest.mark.parametrize("name", ["devices", "fading", "layouts", "rate", "uavs"])
def test_labels_along_the_axis_stand_apart(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str) -> None:
    suite = Suite.load(name)
    axis = {"axis": suite.axis.title, "scale": suite.axis.scale}
    flown = [rows("greedy", "planner", point.label, point.x, 9, 11, **axis) for point in suite.points]
    figure = drawn(monkeypatch, written(tmp_path / "s.csv", *flown))
    figure.canvas.draw()
    (axes,) = figure.axes
    low, high = axes.get_xlim()
    ticks = zip(axes.get_xticks(), axes.get_xticklabels(), strict=True)
    boxes = sorted(label.get_window_extent().extents.tolist() for x, label in ticks if low <= x <= high)
    assert len(boxes) > 5
    assert all(one[2] + 0.03 * figure.dpi < other[0] for one, other in pairwise(boxes))


def test_budgets_that_differ_stand_below_the_figure(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    budgets = ((50, 1000), (10, 1000), (25, 3000))
    learned = [rows("mappo", "trained", str(x), x, x, seed=0, slots=slots) for x, slots in budgets]
    planner = rows("greedy", "planner", "10", 10, 9)
    title = drawn(monkeypatch, written(tmp_path / "s.csv", *learned, planner)).legends[0].get_title().get_text()
    assert "MAPPO: trained with slots = 1,000 at 10, 50; 3,000 at 25" in title
    figure = drawn(monkeypatch, written(tmp_path / "s.csv", *learned[:2], planner))
    assert "trained with" not in figure.legends[0].get_title().get_text()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("zero-shot", "shot", "line 2, column 'how': 'shot' is not one of trained, zero-shot, planner"),
        (",7,", ",seven,", "line 2, column 'mean_aou_slots': 'seven' is not a finite number"),
        (",7,", ",,", "line 2, column 'mean_aou_slots': '' is not a finite number"),
        ("linear", "curved", "line 2, column 'scale': 'curved' is not one of linear, log, category"),
        ("linear", "log", "column 'scale' differs"),
        ("axis", "axes", "column 'axis' is missing"),
        (",s,1", ",t,1", "column 'suite' differs"),
        ("yes", "maybe", "line 2, column 'joined': 'maybe' is not one of yes, no"),
        (",500", ",many", "line 2, column 'slots': 'many' is not a whole number"),
        (",500", ",9e30", "line 2, column 'slots': '9e30' is not a whole number"),
        (",500", ",500,600", "line 2: [0-9]+ values, expected [0-9]+"),
    ],
)
def test_malformed_tables_name_the_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    parts = [rows("mappo", "zero-shot", str(x), x, 6 + x, seed=0, slots=500) for x in (1, 2)]
    text = written(tmp_path / "s.csv", *parts).read_text()
    assert old in text
    (tmp_path / "s.csv").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=words):
        read_suites([tmp_path / "s.csv"])


def test_tables_of_one_suite_are_drawn_together(shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    suites = Path("results/suites")
    first = written(
        suites / "s.csv", rows("mappo", "trained", "1", 1, 7, seed=0), rows("greedy", "planner", "1", 1, 8, 10)
    )
    other = rows("greedy", "planner", "1", 1, 99), rows("any-map", "zero-shot", "2", 2, 3, seed=0)
    second = written(suites / "mine" / "s.csv.gz", *other)
    (joined,) = read_suites([first, second])
    found = joined.rows[["point", "policy", "mean_aou_slots"]].to_numpy().tolist()
    assert found == [["1", "mappo", 7], ["1", "greedy", 9], ["2", "any-map", 3]]  # of a row twice, the first counts
    assert joined.path == first
    code, out, _ = shell("plot suite")
    assert (code, out.split()) == (0, ["results/suites/suite-s.png", "results/suites/suite-s.pdf"])
    written(second, *(part.with_values(axis="y") for part in other))
    code, out, err = shell("plot suite")
    assert (code, out) == (2, "")
    assert "mine/s.csv.gz: its axis is not that of results/suites/s.csv" in err
