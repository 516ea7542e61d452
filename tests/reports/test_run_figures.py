"""Figures from run folders: the runs become the tables of a study, in slots, and are drawn as a study is."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from uavaou import InputError, Scenario
from uavaou.algorithms.registry import load_config
from uavaou.evaluation import flights
from uavaou.evaluation.flights import Flights
from uavaou.reports.figures import plot_runs, read_runs
from uavaou.runs.flights import training_curves
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.statistics import band_over_missions

HEADER = ["mission", "slots", "wall_s", "reward_s", "mean_aou_s", "communications", "devices_served"]
VALIDATION = ["evaluation/mean_aou_greedy_s", "evaluation/mean_aou_sample_s", "time/slots", "time/wall_s"]
TINY = Scenario.load("tiny")
LANES, SLOTS, DEVICES, TAU = 4, TINY.slots, TINY.devices, TINY.slot_length_s
TRAINING_FIGURES = {"figure-3-reward", "figure-4-aou", "figure-5-communications", "figure-6-devices-served"}
ALL_FIGURES = TRAINING_FIGURES | {"aou-wall-clock", "figure-7-aou-execution", "figure-8-communications-by-period"}


# -- run folders as training writes them ---------------------------------------------------------------


def evaluated(policy: str, level_s: float, missions: int = 6, seed: int | None = None) -> Flights:
    """The flights of an evaluation."""
    rng = np.random.default_rng([len(policy), missions])
    counts, period = rng.integers(2, 9, (missions, DEVICES)), TINY.draw_layout().update_period
    alike = band_over_missions(np.stack([counts[:, period == one].mean(axis=1) for one in np.unique(period)], axis=1))
    ages = rng.uniform(0.8, 1.2, SLOTS) * level_s / TAU
    rows = {
        "mission_seed": np.arange(missions),
        "mean_aou_slots": rng.uniform(0.8, 1.2, missions) * level_s / TAU,
        "communications": rng.integers(20, 30, missions),
        "devices_served": DEVICES,
    }
    slots = {"curve": flights.SLOTS, "x": np.arange(1, SLOTS + 1), "mean_aou_slots": ages}
    devices = {"curve": flights.DEVICES, "x": np.arange(DEVICES), "communications": counts.mean(axis=0)}
    periods = {"curve": flights.PERIODS, "x": np.unique(period), "communications": alike.value}
    bands = {"low": 0.9 * ages, "high": 1.2 * ages}, {"low": alike.low, "high": alike.high}
    curves = [slots | bands[0], devices, periods | bands[1]]
    return Flights.of(rows, curves, policy=policy, scenario="tiny", seed=seed)


def write_run(root: Path, algorithm: str = "mappo", seed: int = 0, missions: int = 80, evaluation: bool = True) -> Path:
    folder = root / "tiny" / algorithm / f"seed-{seed}"
    folder.mkdir(parents=True)
    rng = np.random.default_rng([seed, len(algorithm)])
    with (folder / "episodes.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for mission in range(missions):
            ended = (mission // LANES + 1) * LANES * SLOTS  # missions side by side end together
            aou = 5000 * np.exp(-5 * mission / missions) * rng.uniform(0.8, 1.2) + 20
            writer.writerow([mission + 1, ended, 0.01 * ended, -SLOTS * aou, aou, rng.integers(10, 30), 4])
    config = RunConfig(TINY, load_config(algorithm), seed)
    (folder / "config.yaml").write_text(config.to_yaml(), encoding="utf-8")
    if evaluation:
        rows = [VALIDATION, ["", "", 10, 1], [900, 950, 480, 4.8], [60, 70, 960, 9.6]]
        (folder / "progress.csv").write_text("".join(",".join(map(str, row)) + "\n" for row in rows))
        write_evaluation(folder, evaluated(algorithm, 40, seed=seed), evaluated("greedy", 60))
    return folder


def write_evaluation(folder: Path, *tables: Flights) -> None:
    Flights.joined(tables).write(folder)


def labels_of(figure: Figure) -> set[str]:
    """What the lines of all panels are called."""
    return {label for axes in figure.axes for label in axes.get_legend_handles_labels()[1]}


# -- figures -------------------------------------------------------------------------------------------


def test_seeds_of_an_algorithm_are_one_line_in_slots(tmp_path: Path, drawn: dict[str, Any]) -> None:
    runs = [write_run(tmp_path, "mappo", seed) for seed in range(3)] + [write_run(tmp_path, "vdn")]
    plot_runs(runs, tmp_path / "out")
    assert set(drawn) == {f"out/{name}" for name in ALL_FIGURES}
    fourth = drawn["out/figure-4-aou"]
    assert "95 % interval over seeds; none (1 seed)" in fourth.legends[0].get_title().get_text()
    lines = {line.get_label(): line for line in fourth.axes[0].get_lines()}
    assert set(lines) == {"MAPPO (3 seeds)", "VDN (1 seed)", "greedy"}
    groups = [training_curves(RunFolder(folder), TINY)[0]["mean_aou_slots"] for folder in runs[:3]]
    aou = np.array(groups).reshape(3, -1, LANES).mean(axis=(0, 2))
    np.testing.assert_allclose(lines["MAPPO (3 seeds)"].get_ydata(), aou)  # missions that end together are one point
    assert fourth.axes[0].get_ylabel() == "mean AoU (slots)"
    wall = {line.get_label(): line for line in drawn["out/aou-wall-clock"].axes[0].get_lines()}
    assert wall["MAPPO (3 seeds)"].get_ydata()[-1] == pytest.approx(60 / TAU)


def test_runs_of_other_published_settings_have_a_line_and_an_evaluation_of_their_own(
    tmp_path: Path, drawn: dict[str, Any]
) -> None:
    own, paper = write_run(tmp_path), tmp_path / "tiny" / "mappo-paper+slots=9" / "seed-0"
    paper.parent.mkdir()
    write_run(tmp_path / "elsewhere").rename(paper)
    plot_runs([own, paper], tmp_path / "out")
    for name in ("figure-4-aou", "figure-7-aou-execution"):
        assert {label.split(" (")[0] for label in labels_of(drawn[f"out/{name}"])} == {"MAPPO", "mappo-paper", "greedy"}


def test_a_training_too_short_for_a_curve_says_so(tmp_path: Path, drawn: dict[str, Any]) -> None:
    for missions, short in ((2 * LANES, True), (3 * LANES, False)):
        plot_runs([write_run(tmp_path / str(missions), missions=missions, evaluation=False)], tmp_path / "out")
        title = drawn["out/figure-4-aou"].legends[0].get_title().get_text()
        assert (f"too short for a curve: missions end every {LANES * SLOTS} training slots" in title) == short


def test_a_short_training_is_drawn_by_its_validations(tmp_path: Path, drawn: dict[str, Any]) -> None:
    played = "evaluation/reward_sample_s,evaluation/communications_sample,evaluation/devices_served_sample"
    header = ",".join(VALIDATION) + "," + played
    for missions, validations, expected in ((2 * LANES, 3, True), (2 * LANES, 2, False), (3 * LANES, 3, False)):
        folder = write_run(tmp_path / f"{missions} {validations}", missions=missions, evaluation=False)
        rows = [f"{9 - n},{90 - n},{48 * n},{n},{-1000 + n},{20 + n},{n}" for n in range(1, validations + 1)]
        (folder / "progress.csv").write_text("\n".join([header, *rows, ",,400,4,,,"]) + "\n")
        plot_runs([folder], tmp_path / "out")
        figures = [drawn[f"out/{name}"] for name in sorted(TRAINING_FIGURES)]
        said = ["validation missions, actions sampled" in one.legends[0].get_title().get_text() for one in figures]
        assert said == [expected] * 4
        if expected:
            lines = [figure.axes[0].get_lines()[0] for figure in figures]
            assert all(np.allclose(line.get_xdata(), np.array([48, 96, 144]) / SLOTS) for line in lines)
            found = [line.get_ydata().tolist() for line in lines]
            reward = [SLOTS * 89, SLOTS * 88, SLOTS * 87]  # its size, in s
            assert found == [reward, pytest.approx([89 / TAU, 88 / TAU, 87 / TAU]), [21, 22, 23], [1, 2, 3]]


def test_all_planners_evaluated_beside_a_run_are_drawn(tmp_path: Path, drawn: dict[str, Any]) -> None:
    folder = write_run(tmp_path)
    others = {"greedy": 60, "random": 900, "stay": 5000}
    write_evaluation(
        folder, evaluated("mappo", 40, seed=0), *(evaluated(name, level) for name, level in others.items())
    )
    plot_runs([folder], tmp_path / "out")
    labels = {name: labels_of(figure) for name, figure in drawn.items()}
    for name in TRAINING_FIGURES | {"aou-wall-clock"}:  # stay's level would leave no room for the others
        assert labels[f"out/{name}"] == {"MAPPO", "greedy", "random"}
    for name in ("figure-7-aou-execution", "figure-8-communications-by-period"):
        assert labels[f"out/{name}"] == {"MAPPO", "greedy", "random", "stay"}


def test_intervals_of_a_single_run_are_over_missions(tmp_path: Path, drawn: dict[str, Any]) -> None:
    folder = write_run(tmp_path)
    own = Flights.read(folder).where(policy="mappo").curves
    plot_runs([folder], tmp_path / "out")
    over = "95 % interval over missions"
    seventh, eighth = (drawn[f"out/figure-{name}"] for name in ("7-aou-execution", "8-communications-by-period"))
    assert seventh.get_supxlabel().endswith(f"bands: {over} (1 seed)\nplanners: {over}")
    assert eighth.legends[0].get_title().get_text() == f"dot: one device; bar: {over} (1 seed)\nplanners: {over}"
    band = seventh.axes[0].collections[0].get_paths()[0].vertices
    slots = own[own["curve"] == flights.SLOTS]
    assert (band[:, 1].min(), band[:, 1].max()) == pytest.approx((slots["low"].min(), slots["high"].max()))
    bars = [path.vertices[:, 1] for path in eighth.axes[0].collections[0].get_paths()]
    periods = own[own["curve"] == flights.PERIODS]
    np.testing.assert_allclose(bars, periods[["low", "high"]].to_numpy())


def test_runs_are_written_as_png_and_pdf(tmp_path: Path) -> None:
    paths = plot_runs([write_run(tmp_path / "results", missions=4, evaluation=False)], tmp_path / "figures")
    assert {path.stem for path in paths} == TRAINING_FIGURES
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {path.name for path in paths}  # no drafts
    assert all(path.stat().st_size > 1000 for path in paths)


def test_figures_of_two_scenarios_go_to_two_folders(tmp_path: Path, drawn: dict[str, Any]) -> None:
    run = write_run(tmp_path / "results", missions=3, evaluation=False)
    other = write_run(tmp_path / "others", missions=3, evaluation=False)
    replace_in("config.yaml", "name: tiny", "name: hilly")(other)
    plot_runs([run, other], tmp_path)
    assert {name.split("/")[0] for name in drawn} == {"tiny", "hilly"}


def test_overrides_of_the_folder_stay_in_the_name(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "mappo", evaluation=False)
    moved = folder.parent.with_name("mappo+gamma=0.9") / folder.name
    moved.parent.mkdir()
    folder.rename(moved)
    assert list(read_runs([moved]).algorithms) == ["mappo+gamma=0.9"]


def test_a_line_cut_off_while_writing_is_left_out(tmp_path: Path) -> None:
    folder = write_run(tmp_path, evaluation=False)
    with (folder / "episodes.csv").open("a", encoding="utf-8") as file:
        file.write("81,10")
    (run,) = read_runs([folder]).curves(flights.TRAINING, "mappo", "tiny")
    assert len(run["x"]) == 80


# -- bad input -----------------------------------------------------------------------------------------


def replace_in(name: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / name).read_text(encoding="utf-8")
        (folder / name).write_text(text.replace(old, new, 1), encoding="utf-8")

    return change


BROKEN: list[tuple[Callable[[Path], object], list[str]]] = [
    (lambda folder: RunFolder(folder).config.unlink(), ["config.yaml"]),
    (lambda folder: (folder / "episodes.csv").unlink(), ["episodes.csv", "cannot be read"]),
    (lambda folder: (folder / "episodes.csv").write_text(""), ["episodes.csv", "is missing"]),
    (lambda folder: (folder / "episodes.csv").write_text(",".join(HEADER) + "\n"), ["no mission has ended"]),
    (replace_in("episodes.csv", "wall_s", "seconds"), ["episodes.csv", "'wall_s' is missing"]),
    (replace_in("episodes.csv", "\n1,48,", "\n1,many,"), ["episodes.csv: line 2", "'slots'", "'many'"]),
    (replace_in("episodes.csv", "\n1,48,", "\n1,nan,"), ["episodes.csv: line 2", "'slots'"]),
    (replace_in("episodes.csv", "\n2,48,", "\n2\n"), ["episodes.csv: line 3", "1 values"]),
    (replace_in("progress.csv", "900", "none"), ["progress.csv: line 3", "'none'"]),
    (replace_in("config.yaml", "algorithm:", "algorithm: ]"), ["config.yaml", "not valid YAML"]),
    (lambda folder: (folder / "flights.csv.gz").write_text("x"), ["flights.csv.gz", "not packed by gzip"]),
]


@pytest.mark.parametrize(("break_it", "words"), BROKEN)
def test_malformed_run_is_an_input_error(tmp_path: Path, break_it: Callable[[Path], object], words: list[str]) -> None:
    folder = write_run(tmp_path / "results")
    break_it(folder)
    with pytest.raises(InputError) as raised:
        plot_runs([folder], tmp_path / "figures")
    assert all(word in str(raised.value) for word in words), str(raised.value)
    assert "\n" not in str(raised.value)


def test_figures_need_runs_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no run folders"):
        plot_runs([], tmp_path)
    (tmp_path / "taken").write_text("")
    run = write_run(tmp_path / "results", missions=4, evaluation=False)
    with pytest.raises(InputError, match="cannot write"):
        plot_runs([run], tmp_path / "taken")
