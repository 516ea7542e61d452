"""The figure of a suite from its table."""

from __future__ import annotations

import csv
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from tests.committed import RESULTS
from tests.experiments.small_suites import GOOD, OWN, call
from uavaou.errors import InputError
from uavaou.experiments.suite import Suite
from uavaou.experiments.suite_flights import plan_suite, play_suite, write_suite
from uavaou.planners import make_planner
from uavaou.reports import style
from uavaou.reports.suites import plot_suite, read_suite, read_suites


def test_a_table_is_drawn(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    call(capsys, "eval run --policy greedy --suite own.yaml --episodes 3 --quiet --out results/suites/own.csv")
    code, out, _ = call(capsys, "plot suite")
    assert code == 0
    assert out.split() == ["results/suites/suite-own.png", "results/suites/suite-own.pdf"]
    assert (place / "results" / "suites" / "suite-own.pdf").read_bytes().startswith(b"%PDF")
    table = read_suite(place / "results" / "suites" / "own.csv")
    assert list(table.points.values()) == sorted(table.points.values())


@pytest.mark.parametrize("scale", ["linear", "log", "category"])
def test_seeds_and_single_missions_are_drawn(tmp_path: Path, scale: str) -> None:
    head = "suite,point,x,policy,trained,seed,training_slots,missions,mean_aou_slots,low,high,axis,scale,joined\n"
    kinds = ((1, "trained"), (30, "zero-shot"))
    rows = [f"s,{x},{x},mappo,{kind},{s},9,1,{x + s},,,x (m),{scale},yes\n" for x, kind in kinds for s in (0, 1)]
    (tmp_path / "s.csv").write_text(head + "".join(rows) + f"s,none,40,greedy,planner,,,1,0,,,x (m),{scale},yes\n")
    paths = plot_suite(read_suite(tmp_path / "s.csv"), tmp_path)
    assert all(path.stat().st_size > 5000 for path in paths)


def drawn(monkeypatch: pytest.MonkeyPatch, table: Path) -> Any:
    """The figure of a table, as it is saved."""
    figures: list[Any] = []
    monkeypatch.setattr(style, "save", lambda figure, *_: figures.append(figure) or [])
    plot_suite(read_suite(table), table.parent)
    return figures[0]


@pytest.mark.parametrize("scale", ["linear", "log", "category"])
def test_lines_join_all_points_but_marked_ones(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, scale: str) -> None:
    points = [
        {"label": "250 slots", "x": 250, "set": {"speed_m_s": 20}}, {"label": "500 slots", "x": 500},
        {"label": "900", "x": 900, "joined": False},
    ]  # fmt: skip
    axis = {"label": "budget", "scale": scale}
    suite = Suite.from_dict(GOOD | {"axis": axis, "points": points}, "own", "own.yaml")
    plan = plan_suite(suite, {}, ["stay"], "tiny")
    silent = SimpleNamespace(start=lambda name: None, after_slot=lambda slots, world: None)
    results = list(play_suite(plan, {"stay": make_planner("stay")}, 1, 0, silent))
    assert write_suite(plan, results, 1, 0, table=tmp_path / "s.csv") == [f"wrote {tmp_path / 's.csv'}"]
    assert [row["joined"] for row in csv.DictReader((tmp_path / "s.csv").open())] == ["yes", "yes", "no"]
    (axes,) = drawn(monkeypatch, tmp_path / "s.csv").axes
    lines = [list(line.get_xdata()) for line in axes.lines if len(line.get_xdata()) > 1]
    assert lines == ([] if scale == "category" else [[250.0, 500.0]])


@pytest.mark.parametrize("name", ["devices", "fading", "layouts", "rate", "uavs"])
def test_labels_along_the_axis_stand_apart(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    figure = drawn(monkeypatch, RESULTS / "suites" / f"{name}.csv")
    figure.canvas.draw()
    (axes,) = figure.axes
    low, high = axes.get_xlim()
    ticks = zip(axes.get_xticks(), axes.get_xticklabels(), strict=True)
    boxes = sorted(label.get_window_extent().extents.tolist() for x, label in ticks if low <= x <= high)
    assert len(boxes) > 5
    assert all(one[2] + 0.03 * figure.dpi < other[0] for one, other in pairwise(boxes))


def test_no_line_leads_to_an_infinite_rician_factor() -> None:
    assert [point.label for point in Suite.load("fading").points if not point.joined] == ["none"]


def test_budgets_that_differ_stand_below_the_figure(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    head = "suite,point,x,policy,trained,seed,training_slots,mean_aou_slots,low,high,axis,scale,joined\n"
    budgets = ((10, 1000), (25, 3000), (50, 1000))
    rows = [f"s,{x},{x},mappo,trained,0,{slots},{x},,,x,linear,yes\n" for x, slots in budgets]
    planner = "s,10,10,greedy,planner,,,9,,,x,linear,yes\n"
    (tmp_path / "s.csv").write_text(head + "".join(rows) + planner)
    title = drawn(monkeypatch, tmp_path / "s.csv").legends[0].get_title().get_text()
    assert "MAPPO: trained with slots = 1,000 at 10, 50; 3,000 at 25" in title
    (tmp_path / "s.csv").write_text(head + rows[0] + rows[2] + planner)
    assert "trained with" not in drawn(monkeypatch, tmp_path / "s.csv").legends[0].get_title().get_text()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("zero-shot", "shot", "line 2, column 'trained': 'shot'"),
        (",7,", ",seven,", "column 'mean_aou_slots': 'seven'"),
        ("linear", "curved", "column 'scale' differs"),
        ("axis", "axes", "column 'axis' is missing"),
        ("s,1", "t,1", "column 'suite' differs"),
        (",yes", ",maybe", "line 2, column 'joined': 'maybe' is not one of yes, no"),
        (",500,", ",many,", "line 2, column 'training_slots': 'many'"),
    ],
)
def test_malformed_tables_name_the_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    head = "suite,point,x,policy,trained,seed,training_slots,mean_aou_slots,low,high,axis,scale,joined\n"
    text = head + "s,1,1,mappo,zero-shot,0,500,7,,,x,linear,yes\ns,2,2,mappo,zero-shot,0,500,8,,,x,linear,yes\n"
    (tmp_path / "s.csv").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=words):
        read_suite(tmp_path / "s.csv")


def test_tables_of_one_suite_are_drawn_together(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    head, suites = "suite,point,x,policy,trained,seed,mean_aou_slots,low,high,axis,scale\n", Path("results/suites")
    (suites / "mine").mkdir(parents=True)
    (suites / "s.csv").write_text(
        head + "s,1,1,mappo,trained,0,7,6,8,x,linear\ns,1,1,greedy,planner,,9,8,10,x,linear\n"
    )
    other = "s,1,1,greedy,planner,,99,98,100,x,linear\ns,2,2,any-map,zero-shot,0,3,2,4,x,linear\n"
    (suites / "mine" / "s.csv").write_text(head + other)
    (joined,) = read_suites([suites / "s.csv", suites / "mine" / "s.csv"])
    found = [(row.point, row.policy, row.aou.value) for row in joined.rows]
    assert found == [("1", "mappo", 7), ("1", "greedy", 9), ("2", "any-map", 3)]  # of a row twice, the first counts
    assert joined.path == suites / "s.csv"
    code, out, _ = call(capsys, "plot suite")
    assert (code, out.split()) == (0, ["results/suites/suite-s.png", "results/suites/suite-s.pdf"])
    (suites / "mine" / "s.csv").write_text(head + other.replace(",x,", ",y,"))
    code, out, err = call(capsys, "plot suite")
    assert (code, out) == (2, "")
    assert "mine/s.csv: its axis is not that of results/suites/s.csv" in err


def test_a_table_from_before_the_newer_columns_is_read(tmp_path: Path) -> None:
    head = "suite,point,x,policy,trained,seed,missions,mean_aou_slots,low,high,axis,scale\n"
    (tmp_path / "s.csv").write_text(head + "s,1,1,mappo,trained,0,9,7,6,8,x,linear\n")
    (row,) = read_suite(tmp_path / "s.csv").rows
    assert (row.training_slots, row.joined, row.aou) == (None, True, (7, 6, 8))


def test_suites_in_a_run_folder_do_not_change_its_figures(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    from uavaou.reports.figures import read_runs

    call(capsys, "eval run --suite own.yaml --episodes 2 --quiet")
    assert not read_runs([place / "run"])[0].table("missions")["mission"].size
    one = yaml.safe_load(OWN)
    (place / "alone.yaml").write_text(yaml.safe_dump(one | {"points": one["points"][:1]}))
    (place / "off.yaml").write_text(yaml.safe_dump(one | {"points": one["points"][1:2]}))
    for suite in ("alone", "off"):
        call(capsys, f"eval run --policy greedy --suite {suite}.yaml --episodes 2 --quiet")
    found = read_runs([place / "run"]).results  # a suite of the run's own point serves figures 7 and 8
    assert found.planners == ("greedy",)
    assert found.table("execution", "greedy")["mean_aou_slots"].size
