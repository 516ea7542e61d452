"""A study's figures from its tables alone, its recorded missions, and its export for marl-eval."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from matplotlib.image import imread

from tests.synthetic_study import MAPPO, PLANNERS, SCENARIO, SLOT_S, VDN, K, Variant, write_study
from uavaou.errors import InputError
from uavaou.evaluation.recorded_mission import RecordedMission, Recording, read_mission, record_mission, write_mission
from uavaou.planners import make_planner
from uavaou.reports import style
from uavaou.reports.references import best_planner, comparable, in_all_scenarios
from uavaou.reports.study_figures import _line, _over_time, plot_study
from uavaou.runs.folder import RunFolder
from uavaou.runs.policy import load_run
from uavaou.scenario import Scenario
from uavaou.studies.best import record_missions
from uavaou.studies.marl_eval import to_marl_eval
from uavaou.studies.results import read_study, study_folders
from uavaou_cli.main import main

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


def record(folder: Path, policy: str = "mappo", planner: str = "greedy") -> RecordedMission:
    scenario = Scenario.load("tiny")
    recording = record_mission(scenario, make_planner(planner), 5)
    mission = RecordedMission(scenario, policy, 0, 5, recording)
    write_mission(folder / f"mission-{policy}.json", mission)
    return mission


def run_cli(place: Path, code: str) -> subprocess.CompletedProcess[str]:
    start = f"import sys; sys.path[:0] = [{str(ROOT)!r}, {str(ROOT / 'cli')!r}]; from uavaou_cli.main import main; "
    return subprocess.run([sys.executable, "-c", start + code], cwd=place, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_without_arguments_everything_is_drawn_without_torch(tmp_path: Path) -> None:
    study = write_study(tmp_path / "results" / "studies" / "paper")
    record(study)
    record(study, "vdn", "random")
    begun = time.monotonic()
    done = run_cli(tmp_path, "code = main(['plot', 'figures']); assert 'torch' not in sys.modules; sys.exit(code)")
    assert done.returncode == 0, done.stderr
    assert time.monotonic() - begun < 30
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


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The figures by path; the files cost the time."""
    figures: dict[str, Any] = {}

    def keep(figure: Any, folder: Path, name: str) -> list[Path]:
        figures[f"{folder.name}/{name}"] = figure
        return [folder / name]

    monkeypatch.setattr(style, "save", keep)
    return figures


def test_several_scenarios_get_a_folder_each(tmp_path: Path, drawn: dict[str, Any]) -> None:
    study = write_study(tmp_path / "many", scenarios=("paper", "a b?"), missions=4)
    plot_study(study, tmp_path / "out")
    expected = {f"{place}/{name}" for place in ("paper", "a b%3F") for name in OF_A_SCENARIO}
    assert set(drawn) == expected | {f"out/{name}" for name in AGGREGATES}
    assert "multiple of the lower bound" in drawn["out/aou-iqm"].get_supxlabel()


def test_figures_show_what_the_tables_say(tmp_path: Path, drawn: dict[str, Any]) -> None:
    study = write_study(tmp_path / "study", seeds=3)
    tables = read_study(study)
    plot_study(study, tmp_path / "out")
    axes = drawn["out/figure-4-aou"].axes[0]
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert set(lines) == {"MAPPO", "QMIX", "VDN", "best-first", "lower bound"}
    curve = tables.stack("curves", "mappo", "paper", "mean_aou_slots")
    np.testing.assert_allclose(lines["MAPPO"].get_ydata(), curve.mean(axis=0))
    slots = tables.stack("curves", "mappo", "paper", "slots")[0]
    np.testing.assert_allclose(lines["MAPPO"].get_xdata(), slots / K)
    assert "95 % interval over 3 seeds" in drawn["out/figure-4-aou"].legends[0].get_title().get_text()
    assert lines["lower bound"].get_ydata() == [25.0, 25.0]

    reward = {line.get_label(): line for line in drawn["out/figure-3-reward"].axes[0].get_lines()}
    np.testing.assert_allclose(reward["lower bound"].get_ydata(), 25.0 * K * SLOT_S)  # on a reversed axis
    np.testing.assert_allclose(reward["best-first"].get_ydata(), 60 * K * SLOT_S, rtol=0.05)

    execution = {line.get_label(): line for line in drawn["out/figure-7-aou-execution"].axes[0].get_lines()}
    table = tables.stack("execution", "vdn", "paper", "mean_aou_slots")
    np.testing.assert_allclose(execution["VDN"].get_ydata(), table.mean(axis=0))
    assert "lower bound" not in execution  # it bounds the mean over slots, not a slot

    wall = {line.get_label(): line for line in drawn["out/aou-wall-clock"].axes[0].get_lines()}
    held = tables.stack("validation", "qmix", "paper", "mean_aou_slots")
    assert wall["QMIX"].get_ydata()[0] == pytest.approx(held[:, 0].mean())
    assert wall["QMIX"].get_ydata()[-1] == pytest.approx(held[:, -1].mean())


def test_one_seed_and_no_planners_or_bound(tmp_path: Path, drawn: dict[str, Any]) -> None:
    study = write_study(tmp_path / "study", {"mappo": MAPPO}, {}, seeds=1, bound=None)
    plot_study(study, tmp_path / "out")
    assert set(drawn) == {f"out/{name}" for name in OF_A_SCENARIO | AGGREGATES - {"probability-of-improvement"}}
    assert "bands: none (1 seed)" in drawn["out/figure-4-aou"].legends[0].get_title().get_text()
    bars = drawn["out/figure-8-communications-by-period"].legends[0].get_title().get_text()
    assert bars == "dot: one device; bar: none (1 seed)"
    assert "missions (1 seed) of 1 scenario" in drawn["out/aou-iqm"].get_supxlabel()
    assert "seeds and" not in drawn["out/performance-profile"].legends[0].get_title().get_text()


def test_intervals_say_what_they_are_over(tmp_path: Path, drawn: dict[str, Any]) -> None:
    study = write_study(tmp_path / "study", seeds=3)
    plot_study(study, tmp_path / "out")
    eighth = drawn["out/figure-8-communications-by-period"].legends[0]
    assert eighth.get_title().get_text() == "dot: one device; bar: 95 % interval over 3 seeds"
    assert "over\nseeds and missions of" in drawn["out/aou-iqm"].get_supxlabel()
    runs = (study / "runs.csv").read_text().splitlines(keepends=True)
    (study / "runs.csv").write_text(
        "".join(row for row in runs if not row.startswith(("vdn,vdn,paper,1", "vdn,vdn,paper,2")))
    )
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
    (studies / "damaged" / "runs.csv").unlink()
    assert main(["plot", "figures"]) == 2
    assert len(drawn) == 9
    assert "damaged/runs.csv" in capsys.readouterr().err


def test_studies_are_drawn_side_by_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    studies = tmp_path / "results" / "studies"
    for name in ("one", "two"):
        write_study(studies / name, {"mappo": MAPPO}, {}, 1, missions=1, bound=None)
    (studies / "one" / "runs.csv").unlink()
    assert main(["plot", "figures"]) == 2
    said = capsys.readouterr()
    assert "left out: results/studies/one/runs.csv" in said.err
    assert said.out.splitlines()[0] == "results/studies/two/figures/figure-3-reward.png"
    assert all((tmp_path / line).is_file() for line in said.out.splitlines())


def test_missions_that_end_together_are_one_point() -> None:
    """And the mean over seeds is taken where all of them have it."""
    one = np.array([10.0, 20.0, 20.0, 30.0]), np.array([4.0, 1.0, 3.0, 0.0])
    two = np.array([10.0, 20.0]), np.array([2.0, 4.0])
    line = _line([one, two])
    assert line.x.tolist() == [10.0, 20.0]
    assert line.mean.tolist() == [3.0, 3.0]
    assert _line([two, one]).mean.tolist() == [3.0, 3.0]


def test_seeds_that_were_never_in_training_together_have_one_time() -> None:
    early = {"wall_s": np.array([1.0, 2.0]), "mean_aou_slots": np.array([9.0, 8.0])}
    late = {"wall_s": np.array([5.0, 6.0]), "mean_aou_slots": np.array([7.0, 1.0])}
    for runs in ([early, late], [late, early]):
        line = _over_time(runs)
        assert set(line.x) == {5.0}
        assert set(line.mean) == {7.5}  # what each held at that time


def test_scores_of_scenarios_without_ages_stay_in_slots(tmp_path: Path) -> None:
    study = read_study(write_study(tmp_path / "one", scenarios=("a", "b"), bound=0.0, seeds=1))
    still = {"mappo": {name: np.zeros((1, 3)) for name in ("a", "b")}}
    assert "best-first" in comparable(study, still)[1]
    alone = read_study(write_study(tmp_path / "two", planners={}, scenarios=("a", "b"), bound=None, seeds=1))
    shared, unit = comparable(alone, still)
    assert unit == "in slots $\\tau$"
    assert not np.any(shared["mappo"]["a"])


def test_variants_keep_their_algorithms_colour() -> None:
    looks = style.looks(["mappo", "big", "small vdn"], {"big": "mappo", "mappo": "mappo", "small vdn": "vdn"})
    assert looks["big"].colour == looks["mappo"].colour
    assert looks["mappo"].dash == "-"
    assert looks["big"].dash != "-"
    assert [looks[name].label for name in ("mappo", "big", "small vdn")] == ["MAPPO", "big", "small vdn"]


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


def test_runs_that_are_not_finished_are_left_out(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study", seeds=3)
    runs = (folder / "runs.csv").read_text().splitlines(keepends=True)
    (folder / "runs.csv").write_text("".join(row for row in runs if not row.startswith("mappo,mappo,paper,1,")))
    study = read_study(folder)
    assert study.stack("missions", "mappo", "paper", "mean_aou_slots").shape == (2, 12)
    assert study.stack("missions", "vdn", "paper", "mean_aou_slots").shape == (3, 12)


def test_seeds_of_different_lengths_cannot_be_stacked(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study")
    text = (folder / "missions.csv").read_text().splitlines(keepends=True)
    (folder / "missions.csv").write_text("".join([text[0], *text[2:]]))
    with pytest.raises(InputError, match=r"missions\.csv.*'mappo' on 'paper'"):
        read_study(folder).stack("missions", "mappo", "paper", "mean_aou_slots")


def test_studies_are_found_and_the_papers_is_first(tmp_path: Path) -> None:
    for name in ("other", "paper", "ablation"):
        write_study(tmp_path / "studies" / name, {"mappo": MAPPO}, seeds=1, missions=2)
    assert [folder.name for folder in study_folders(tmp_path)] == ["paper", "ablation", "other"]


# -- recorded missions ---------------------------------------------------------------------------------


def test_a_recorded_mission_is_read_as_it_was_written(tmp_path: Path) -> None:
    mission = record(tmp_path, "tour's")
    again = read_mission(tmp_path / "mission-tour's.json")
    assert (again.scenario, again.policy, again.training_seed, again.mission_seed) == (
        Scenario.load("tiny"), "tour's", 0, 5,
    )  # fmt: skip
    for field in ("positions", "collected_by", "age_sum"):
        np.testing.assert_allclose(getattr(again.recording, field), getattr(mission.recording, field), rtol=1e-12)
    np.testing.assert_array_equal(again.recording.communications, mission.recording.communications)
    np.testing.assert_allclose(again.recording.layout.positions, mission.recording.layout.positions)
    np.testing.assert_array_equal(again.recording.layout.update_period, mission.recording.layout.update_period)


@pytest.mark.slow
def test_the_kept_policies_of_a_study_are_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    small = "missions=2 rollout_slots=12 batch_rows=24 evaluate_every_slots=24 evaluation_missions=2"
    options = [word for setting in small.split() for word in ("--set", f"algorithm.{setting}")]
    assert main(["train", "--scenario", "tiny", "--slots", "48", "--seed", "3", "--quiet", *options]) == 0
    trained = next(tmp_path.glob("results/tiny/*/seed-3"))
    study = write_study(tmp_path / "study", {"mappo": MAPPO}, seeds=1, scenarios=("none kept", "a%b"))
    assert record_missions(study) == []
    shutil.copytree(trained, study / "best" / "a%25b" / "big mappo" / "seed-3")
    record(study, "of tiny")
    other = record(study, "of another")
    write_mission(
        study / "mission-of another.json", replace(other, scenario=other.scenario.replace(rate_min_bit_s=1000))
    )
    assert record_missions(study) == [study / "mission-big mappo.json"]
    assert {path.name for path in study.glob("mission-*")} == {"mission-big mappo.json", "mission-of tiny.json"}
    mission = read_mission(study / "mission-big mappo.json")
    assert (mission.policy, mission.training_seed, mission.mission_seed) == ("big mappo", 3, 10_000)
    played = record_mission(Scenario.load("tiny"), load_run(RunFolder(trained)), 10_000)
    np.testing.assert_array_equal(mission.recording.collected_by, played.collected_by)
    np.testing.assert_allclose(mission.recording.age_sum, played.age_sum)


def change(field: str, value: Any) -> Any:
    def edit(content: dict[str, Any]) -> None:
        (content["layout"] if field in content["layout"] else content)[field] = value

    return edit


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (change("schema", 2), "schema 1"),
        (change("positions_m", [[0.0]]), "'positions_m'"),
        (change("age_sum_slots", "old"), "'age_sum_slots'"),
        (change("collected_by", [[9] * 4] * 12), "'collected_by' names UAVs outside 0 to 1"),
        (change("collected_by", [[0.5] * 4] * 12), "not whole"),
        (change("update_period_slots", [0, 1, 1, 1]), "'update_period_slots'"),
        (change("mission_seed", None), "'mission_seed'"),
        (lambda content: content.pop("layout"), "'layout'"),
        (lambda content: content["scenario"].update(slots=-1), "slots"),
    ],
)
def test_a_damaged_recording_is_an_input_error(tmp_path: Path, edit: Any, words: str) -> None:
    record(tmp_path)
    path = tmp_path / "mission-mappo.json"
    content = json.loads(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=words) as raised:
        read_mission(path)
    assert "mission-mappo.json" in str(raised.value)


def test_nothing_pending_is_no_communication() -> None:
    layout = SCENARIO.draw_layout()
    kept = np.zeros((3, 1, 2)), np.array([[0], [0], [0]]), np.array([[0.0], [0.0], [0.0]])
    one = type(layout)(layout.positions[:1], layout.bandwidth[:1], layout.transmit_power[:1], np.array([2]))
    np.testing.assert_array_equal(Recording(*kept, one).communications[:, 0], [True, True, False])


# -- marl-eval -----------------------------------------------------------------------------------------


def test_export_has_the_structure_that_marl_eval_describes(tmp_path: Path) -> None:
    variants = {"mappo": MAPPO, "vdn": VDN}
    folder = write_study(tmp_path / "study", variants, PLANNERS, seeds=3, scenarios=("a", "b"))
    results = read_study(folder)
    content = json.loads(json.dumps(to_marl_eval(results)))
    assert list(content) == ["uavaou_v0"]
    assert set(content["uavaou_v0"]) == {"a", "b"}
    for algorithms in content["uavaou_v0"].values():
        assert set(algorithms) == {"mappo", "vdn"}  # planners have no training
        for runs in algorithms.values():
            assert set(runs) == {"seed_0", "seed_1", "seed_2"}
            for run in runs.values():
                check_run(run)
    run = content["uavaou_v0"]["b"]["vdn"]["seed_1"]
    study = read_study(folder)
    aou = study.stack("missions", "vdn", "b", "mean_aou_slots")[1].mean()
    assert run["absolute_metrics"]["mean_aou_slots"] == [pytest.approx(aou)]
    assert run["absolute_metrics"]["return"] == [pytest.approx(-aou * K * SLOT_S)]
    assert run["step_4"]["step_count"] == study.runs("validation", "vdn", "b")[1]["slots"][4]


def check_run(run: dict[str, Any]) -> None:
    steps = [key for key in run if key != "absolute_metrics"]
    assert steps == [f"step_{k}" for k in range(len(steps))]
    assert len(steps) == 30
    counts = [run[step]["step_count"] for step in steps]
    assert counts == sorted(counts)
    assert all(isinstance(count, int) for count in counts)
    for step in steps:
        for metric in set(run[step]) - {"step_count", "elapsed_time"}:
            assert isinstance(run[step][metric], list)
            assert len(run[step][metric]) == 1
            assert metric in run["absolute_metrics"]
    assert all(isinstance(values, list) for values in run["absolute_metrics"].values())


def test_export_keeps_the_runs_and_steps_that_all_have(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study", {"mappo": MAPPO, "vdn": VDN}, seeds=3)
    for name, part in (("runs.csv", "vdn,vdn,paper,2,"), ("validation.csv", "mappo,paper,1,60000,")):
        rows = (folder / name).read_text().splitlines(keepends=True)
        kept = [row for row in rows if not row.startswith(part)]
        assert len(kept) == len(rows) - 1
        (folder / name).write_text("".join(kept))
    tasks = to_marl_eval(read_study(folder))["uavaou_v0"]
    assert {len(runs) for runs in tasks["paper"].values()} == {2}
    assert {len(run) for runs in tasks["paper"].values() for run in runs.values()} == {30}  # 29 steps and the last


def test_tables_of_a_study_without_runs_are_an_input_error(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study", {}, {}, bound=None)
    with pytest.raises(InputError, match="no evaluated run"):
        read_study(folder).require_evaluated()
