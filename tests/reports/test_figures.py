"""A study's figures come from its tables alone and show what they say."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from matplotlib.image import imread

from tests.synthetic_study import MAPPO, SLOT_S, K, Variant, record, set_to, without, write_study
from uavaou import read_study
from uavaou.evaluation.flights import SLOTS, TRAINING, VALIDATION
from uavaou.reports.figures import _has_times, _line, _over_time, plot_study
from uavaou.reports.scores import best_planner, comparable, in_all_scenarios
from uavaou_cli.main import main

pytestmark = pytest.mark.usefixtures("few_resamples")
ROOT = Path(__file__).resolve().parents[2]
OF_A_SCENARIO = {
    "figure-3-reward",
    "figure-4-aou",
    "figure-5-communications",
    "figure-6-devices-served",
    "figure-7-aou-execution",
    "figure-8-communications-by-period",
    "aou-wall-clock",
}
AGGREGATES = {"aou-iqm", "probability-of-improvement", "performance-profile"}
MISSIONS = {"missions-side-by-side", "missions-device-ages"}


def run_cli(place: Path, code: str) -> subprocess.CompletedProcess[str]:
    start = f"import sys; sys.path[:0] = [{str(ROOT)!r}, {str(ROOT / 'cli')!r}]; from uavaou_cli.main import main; "
    return subprocess.run([sys.executable, "-c", start + code], cwd=place, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_without_arguments_everything_is_drawn_without_torch(tmp_path: Path) -> None:
    study = write_study(tmp_path / "results" / "studies" / "paper")
    record(study)
    record(study, "vdn", "random")
    code = "from uavaou.statistics import aggregates; aggregates.RESAMPLES = 100; code = main(['plot', 'figures']); "
    done = run_cli(tmp_path, code + "assert 'torch' not in sys.modules; sys.exit(code)")
    assert done.returncode == 0, done.stderr
    paths = [tmp_path / line for line in done.stdout.splitlines()]
    assert {path.stem for path in paths} == OF_A_SCENARIO | AGGREGATES | MISSIONS
    assert {path.parent for path in paths} == {study / "figures"}
    assert {path.suffix for path in paths} == {".png", ".pdf"}
    for path in paths:
        if path.suffix == ".png":
            pixels = imread(path)
            assert pixels.shape[1] >= 690
            assert float(pixels[..., :3].std()) > 0.03, path
        else:
            assert path.read_bytes().startswith(b"%PDF")


def test_without_studies_one_line_says_what_makes_them(tmp_path: Path) -> None:
    done = run_cli(tmp_path, "sys.exit(main(['plot', 'figures']))")
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert "uavaou study run paper" in done.stderr
    assert not any(tmp_path.iterdir())


def test_several_scenarios_get_a_folder_each(tmp_path: Path, drawn: dict[str, Any]) -> None:
    study = write_study(tmp_path / "many", scenarios=("paper", "a b?"), missions=4)
    plot_study(study, tmp_path / "out")
    expected = {f"{place}/{name}" for place in ("paper", "a b%3F") for name in OF_A_SCENARIO}
    assert set(drawn) == expected | {f"out/{name}" for name in AGGREGATES}
    assert "multiples of the lower bound" in drawn["out/aou-iqm"].get_supxlabel()


def test_figures_show_what_the_tables_say(tmp_path: Path, drawn: dict[str, Any]) -> None:
    study = write_study(tmp_path / "study", seeds=3)
    tables = read_study(study)
    plot_study(study, tmp_path / "out")
    axes = drawn["out/figure-4-aou"].axes[0]
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert set(lines) == {"MAPPO", "QMIX", "VDN", "best-first", "lower bound"}
    curve = tables.stack("mappo", "paper", "mean_aou_slots", TRAINING)
    np.testing.assert_allclose(lines["MAPPO"].get_ydata(), curve.mean(axis=0))
    slots = tables.stack("mappo", "paper", "x", TRAINING)[0]
    np.testing.assert_allclose(lines["MAPPO"].get_xdata(), slots / K)
    assert "95 % interval over 3 seeds" in drawn["out/figure-4-aou"].legends[0].get_title().get_text()
    assert lines["lower bound"].get_ydata() == [25.0, 25.0]

    reward = {line.get_label(): line for line in drawn["out/figure-3-reward"].axes[0].get_lines()}
    np.testing.assert_allclose(reward["lower bound"].get_ydata(), 25.0 * K * SLOT_S)  # on a reversed axis
    np.testing.assert_allclose(reward["best-first"].get_ydata(), 60 * K * SLOT_S, rtol=0.05)

    panels = drawn["out/figure-7-aou-execution"].axes  # one for each policy, the best first and in grey in the others
    assert [len(axes.get_lines()) for axes in panels if axes.get_visible()] == [1, 2, 2, 2]
    execution = {axes.get_lines()[-1].get_label(): axes.get_lines()[-1] for axes in panels if axes.get_visible()}
    assert [set(axes.collections) != set() for axes in panels if axes.get_visible()] == [True] * 4
    table = tables.stack("vdn", "paper", "mean_aou_slots", SLOTS)
    np.testing.assert_allclose(execution["VDN"].get_ydata(), table.mean(axis=0))
    assert "lower bound" not in execution  # it bounds the mean over slots, not a slot

    wall = {line.get_label(): line for line in drawn["out/aou-wall-clock"].axes[0].get_lines()}
    held = tables.stack("qmix", "paper", "mean_aou_slots", VALIDATION)
    assert wall["QMIX"].get_ydata()[0] == pytest.approx(held[:, 0].mean())
    assert wall["QMIX"].get_ydata()[-1] == pytest.approx(held[:, -1].mean())


@pytest.mark.parametrize("other", ["two", ""])
def test_a_wall_clock_of_several_processors_says_so(tmp_path: Path, drawn: dict[str, Any], other: str) -> None:
    study = write_study(tmp_path / "study")

    def note() -> bool:
        plot_study(study, tmp_path / "out")
        return "several processors" in drawn["out/aou-wall-clock"].legends[0].get_title().get_text()

    assert not note()
    set_to(study, "processor", other or None, policy="mappo", seed=0)
    assert note()


def test_one_seed_and_no_planners_or_bound(tmp_path: Path, drawn: dict[str, Any]) -> None:
    study = write_study(tmp_path / "study", {"mappo": MAPPO}, {}, seeds=1, bound=None)
    plot_study(study, tmp_path / "out")
    assert set(drawn) == {f"out/{name}" for name in OF_A_SCENARIO | AGGREGATES - {"probability-of-improvement"}}
    assert "bands: none (1 seed)" in drawn["out/figure-4-aou"].legends[0].get_title().get_text()
    bars = drawn["out/figure-8-communications-by-period"].legends[0].get_title().get_text()
    assert bars == "dot: one device; bar: none (1 seed)"
    assert "missions (1 seed) of 1 scenario" in drawn["out/aou-iqm"].get_supxlabel()
    assert "seeds and" not in drawn["out/performance-profile"].legends[0].get_title().get_text()


def test_two_seeds_have_no_band(tmp_path: Path, drawn: dict[str, Any]) -> None:
    study = write_study(tmp_path / "study", {"mappo": MAPPO}, {}, seeds=2, bound=None)
    plot_study(study, tmp_path / "out")
    figure = drawn["out/figure-4-aou"]
    assert "bands: none (2 seeds)" in figure.legends[0].get_title().get_text()
    assert "bands: none (2 seeds)" in drawn["out/figure-7-aou-execution"].get_supxlabel()
    (band,) = figure.axes[0].collections
    assert band.get_datalim(figure.axes[0].transData).height in (-np.inf, 0)


def test_validations_without_times_have_no_line_over_time(tmp_path: Path, drawn: dict[str, Any]) -> None:
    study = write_study(tmp_path / "study")
    flat = read_study(study).curves(VALIDATION, "vdn", "paper")[0] | {"wall_s": np.array([7.0, 7.0])}
    assert not _has_times(flat)
    assert _has_times(flat | {"wall_s": np.array([7.0])})


def test_intervals_say_what_they_are_over(tmp_path: Path, drawn: dict[str, Any]) -> None:
    study = write_study(tmp_path / "study", seeds=3)
    plot_study(study, tmp_path / "out")
    eighth = drawn["out/figure-8-communications-by-period"].legends[0]
    assert eighth.get_title().get_text() == "dot: one device; bar: 95 % interval over 3 seeds"
    assert "over\nseeds and missions of" in drawn["out/aou-iqm"].get_supxlabel()
    for seed in (1, 2):
        without(study, policy="vdn", seed=seed)
    plot_study(study, tmp_path / "some")
    eighth = drawn["some/figure-8-communications-by-period"].legends[0]
    assert eighth.get_title().get_text() == "dot: one device; bar: 95 % interval over seeds; none (1 seed)"
    assert "seeds (where there are several) and missions" in drawn["some/aou-iqm"].get_supxlabel()


@pytest.mark.parametrize(("reference", "own"), [("vdn", "VDN"), (None, "MAPPO"), ("gone", "MAPPO")])
def test_the_reference_is_compared_with_the_others(
    tmp_path: Path, drawn: dict[str, Any], reference: str | None, own: str
) -> None:
    study = write_study(tmp_path / "study", missions=4)
    content = yaml.safe_load((study / "study.yaml").read_text())
    (study / "study.yaml").write_text(yaml.safe_dump(content | {"reference": reference}))
    plot_study(study, tmp_path / "out")
    assert f"mission with {own}\n" in drawn["out/probability-of-improvement"].get_supxlabel()


def test_one_study_keeps_no_other_from_being_drawn(
    tmp_path: Path, drawn: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # other processes would not show what they draw
    studies = tmp_path / "results" / "studies"
    write_study(studies / "begun", {}, {}, bound=None)
    assert main(["plot", "figures"]) == 2  # nothing to draw
    write_study(studies / "odd name [x]", {"a $b c": replace(MAPPO, algorithm="mappo")}, {}, 1, missions=1, bound=None)
    assert main(["plot", "figures"]) == 0
    assert {name.split("/")[1] for name in drawn} == OF_A_SCENARIO | AGGREGATES - {"probability-of-improvement"}
    assert "left out: 'results/studies/begun' holds no evaluated run yet" in capsys.readouterr().err
    drawn["figures/figure-4-aou"].draw_without_rendering()  # no formula begins at the dollar
    drawn.clear()
    write_study(studies / "damaged", {"mappo": MAPPO})
    (studies / "damaged" / "flights.csv.gz").write_text("x")
    assert main(["plot", "figures"]) == 2
    assert len(drawn) == 9
    assert "damaged/flights.csv.gz" in capsys.readouterr().err


@pytest.mark.slow
def test_studies_are_drawn_side_by_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    studies = tmp_path / "results" / "studies"
    for name in ("one", "two"):
        write_study(studies / name, {"mappo": MAPPO}, {}, 1, missions=1, bound=None)
    (studies / "one" / "flights.csv.gz").write_text("x")
    assert main(["plot", "figures"]) == 2
    said = capsys.readouterr()
    assert "left out: results/studies/one/flights.csv.gz" in said.err
    assert said.out.splitlines()[0] == "results/studies/two/figures/figure-3-reward.png"
    assert all((tmp_path / line).is_file() for line in said.out.splitlines())


def test_lines_join_what_ends_together_where_all_seeds_have_it() -> None:
    # And the mean over seeds is taken where all of them have it.
    one = np.array([10.0, 20.0, 20.0, 30.0]), np.array([4.0, 1.0, 3.0, 0.0])
    two = np.array([10.0, 20.0]), np.array([2.0, 4.0])
    line = _line([one, two])
    assert line.x.tolist() == [10.0, 20.0]
    assert line.y.value.tolist() == [3.0, 3.0]
    assert _line([two, one]).y.value.tolist() == [3.0, 3.0]
    early = {"wall_s": np.array([1.0, 2.0]), "mean_aou_slots": np.array([9.0, 8.0])}
    late = {"wall_s": np.array([5.0, 6.0]), "mean_aou_slots": np.array([7.0, 1.0])}
    for runs in ([early, late], [late, early]):
        line = _over_time(runs)
        assert set(line.x) == {5.0}
        assert set(line.y.value) == {7.5}  # what each held at that time


def test_scores_of_scenarios_without_ages_stay_in_slots(tmp_path: Path) -> None:
    study = read_study(write_study(tmp_path / "one", scenarios=("a", "b"), bound=0.0, seeds=1))
    still = {"mappo": {name: np.zeros((1, 3)) for name in ("a", "b")}}
    assert "best-first" in comparable(study, still)[1]
    alone = read_study(write_study(tmp_path / "two", planners={}, scenarios=("a", "b"), bound=None, seeds=1))
    shared, unit = comparable(alone, still)
    assert unit == "slots"
    assert not np.any(shared["mappo"]["a"])


def test_references(tmp_path: Path) -> None:
    study = read_study(write_study(tmp_path / "one", scenarios=("a", "b"), bound=None))
    assert best_planner(study, ["a", "b"]) == "best-first"
    scores = in_all_scenarios(study, ["mappo", "greedy", "nobody"])
    assert set(scores) == {"mappo", "greedy"}
    shared, unit = comparable(study, scores)
    assert "best-first" in unit
    expected = scores["mappo"]["a"] / study.missions("best-first", "mean_aou_slots")["a"].mean()
    np.testing.assert_allclose(shared["mappo"]["a"], expected)
    alone = read_study(write_study(tmp_path / "two", planners={"random": Variant(5.0)}))
    assert best_planner(alone, ["paper"]) is None
