"""Figures from run folders, pictures of a mission, frames, and the interval behind every band."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from matplotlib.image import imread

from uavaou.envs.map import FRAME_SHAPE, render_frame
from uavaou.errors import InputError
from uavaou.evaluation.recorded_mission import Recording
from uavaou.reports import style
from uavaou.reports.figures import plot_figures, training_curve
from uavaou.reports.run_results import Run, read_run
from uavaou.reports.trajectories import plot_trajectories
from uavaou.scenario import Scenario
from uavaou.world import World

HEADER = ["mission", "slots", "wall_s", "reward_s", "mean_aou_s", "communications", "devices_served"]
LANES, SLOTS, DEVICES = 4, 12, 4
TRAINING_FIGURES = {
    "figure-3-reward",
    "figure-4-aou",
    "figure-5-communications",
    "figure-6-devices-served",
    "aou-wall-clock",
}
EVALUATION_FIGURES = {"figure-7-aou-execution", "figure-8-communications-by-period"}


# -- run folders as training writes them ---------------------------------------------------------------


def evaluated(rng: np.random.Generator, level_s: float, whole: bool = True) -> dict[str, Any]:
    """What an evaluation of 6 missions holds for one policy."""
    entry: dict[str, Any] = {
        "mean_aou_s": (level_s * rng.uniform(0.8, 1.2, 6)).tolist(),
        "communications": rng.integers(20, 30, 6).tolist(),
        "devices_served": [DEVICES] * 6,
        "flight_time_s": [[60.0, 70.0]] * 6,
        "violations": {},
    }
    if whole:
        line = level_s * rng.uniform(0.8, 1.2, SLOTS)
        entry |= {
            "update_period_slots": [1, 1, 2, 4],
            "device_communications": rng.integers(2, 9, (6, DEVICES)).tolist(),
            "aou_over_time_s": line.tolist(),
            "aou_over_time_low_s": (0.9 * line).tolist(),
            "aou_over_time_high_s": (1.1 * line).tolist(),
        }
    return entry


def write_run(root: Path, algorithm: str = "mappo", seed: int = 0, missions: int = 80, evaluation: bool = True) -> Path:
    folder = root / "tiny" / algorithm / f"seed-{seed}"
    (folder / "eval").mkdir(parents=True)
    rng = np.random.default_rng([seed, len(algorithm)])
    with (folder / "episodes.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for mission in range(missions):
            ended = (mission // LANES + 1) * LANES * SLOTS  # missions side by side end together
            aou = 5000 * np.exp(-5 * mission / missions) * rng.uniform(0.8, 1.2) + 20
            writer.writerow([mission + 1, ended, 0.01 * ended, -SLOTS * aou, aou, rng.integers(10, 30), 4])
    scenario = Scenario.load("tiny").to_dict()
    config = {"algorithm": {"name": algorithm}, "scenario": scenario, "seed": seed}
    (folder / "config.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    if evaluation:
        policies = {algorithm: evaluated(rng, 40), "greedy": evaluated(rng, 60), "random": evaluated(rng, 900, False)}
        content = {"scenario": "tiny", "episodes": 6, "policies": policies}
        (folder / "eval" / "default.json").write_text(json.dumps(content), encoding="utf-8")
    return folder


def stems(paths: list[Path]) -> set[str]:
    return {path.stem for path in paths}


def is_drawn(path: Path) -> bool:
    """Whether a PNG shows something: more than a few colours, and at least a column wide."""
    pixels = imread(path)
    return pixels.shape[1] >= 690 and float(pixels[..., :3].std()) > 0.03


# -- figures -------------------------------------------------------------------------------------------


def test_figures_of_several_algorithms_and_seeds(tmp_path: Path) -> None:
    runs = [write_run(tmp_path / "results", "mappo", seed) for seed in range(3)] + [
        write_run(tmp_path / "results", "vdn")
    ]
    paths = plot_figures(runs, tmp_path / "figures")
    assert stems(paths) == TRAINING_FIGURES | EVALUATION_FIGURES
    assert all(path.stat().st_size > 1000 for path in paths)
    assert all(is_drawn(path) for path in paths if path.suffix == ".png")
    assert {path.suffix for path in paths} == {".png", ".pdf"}
    left = {path.name for path in (tmp_path / "figures").iterdir()}
    assert left == {path.name for path in paths}  # no drafts stay behind


def test_figures_without_evaluations_or_configs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = write_run(tmp_path / "results", missions=3, evaluation=False)
    (run / "config.yaml").unlink()
    monkeypatch.setattr(style, "save", lambda figure, folder, name: [folder / name])  # the files cost the time
    assert stems(plot_figures([run], tmp_path)) == TRAINING_FIGURES


def test_figures_of_two_scenarios_go_to_two_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = write_run(tmp_path / "results", missions=3, evaluation=False)
    other = write_run(tmp_path / "others", missions=3, evaluation=False)
    replace_in("config.yaml", "name: tiny", "name: hilly")(other)
    monkeypatch.setattr(style, "save", lambda figure, folder, name: [folder / name])
    assert {path.parent.name for path in plot_figures([run, other], tmp_path)} == {"tiny", "hilly"}


def test_the_same_figure_gives_the_same_bytes(tmp_path: Path) -> None:
    written = []
    for folder in ("one", "two"):
        with style.house_style():
            figure, axes = style.new_axes()
            axes.plot([1, 2, 3], label="$x$")
            axes.legend()
            written.append([path.read_bytes() for path in style.save(figure, tmp_path / folder, "line")])
    assert written[0] == written[1]
    assert not any(b"CreationDate" in content for content in written[0])


def test_curve_means_the_missions_of_each_bin(tmp_path: Path) -> None:
    run = read_run(write_run(tmp_path, missions=80))
    curve = training_curve([run], "mean_aou_s")
    by_batch = run.episodes["mean_aou_s"].reshape(-1, 2 * LANES).mean(axis=1)  # 20 ends of missions in 10 bins
    np.testing.assert_allclose(curve.mean, by_batch)
    assert (curve.low <= curve.mean).all()
    assert (curve.mean <= curve.high).all()
    assert run.mission_slots == SLOTS


def test_curve_ends_with_the_shortest_seed(tmp_path: Path) -> None:
    runs = [read_run(write_run(tmp_path, seed=seed, missions=missions)) for seed, missions in ((0, 80), (1, 40))]
    curve = training_curve(runs, "mean_aou_s")
    assert curve.seeds == 2
    assert curve.slots.max() <= 40 * SLOTS
    assert np.isfinite([curve.mean, curve.low, curve.high]).all()


def test_overrides_of_the_folder_stay_in_the_name(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "mappo", evaluation=False)
    moved = folder.parent.with_name("mappo+gamma=0.9") / folder.name
    moved.parent.mkdir()
    folder.rename(moved)
    assert read_run(moved).algorithm == "mappo+gamma=0.9"


# -- bad input -----------------------------------------------------------------------------------------


def replace_in(name: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / name).read_text(encoding="utf-8")
        (folder / name).write_text(text.replace(old, new, 1), encoding="utf-8")

    return change


def change_policy(field: str, value: Any) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "eval" / "default.json"
        content = json.loads(path.read_text(encoding="utf-8"))
        if value is None:
            del content["policies"]["greedy"][field]
        else:
            content["policies"]["greedy"][field] = value
        path.write_text(json.dumps(content), encoding="utf-8")

    return change


BROKEN: list[tuple[Callable[[Path], object], list[str]]] = [
    (lambda folder: (folder / "episodes.csv").unlink(), ["episodes.csv", "cannot be read"]),
    (lambda folder: (folder / "episodes.csv").write_text(""), ["episodes.csv", "'slots' is missing"]),
    (lambda folder: (folder / "episodes.csv").write_text(",".join(HEADER) + "\n"), ["no mission has ended"]),
    (replace_in("episodes.csv", "wall_s", "seconds"), ["episodes.csv", "'wall_s' is missing"]),
    (replace_in("episodes.csv", "\n1,48,", "\n1,many,"), ["episodes.csv: line 2", "'slots'", "'many'"]),
    (replace_in("episodes.csv", "\n1,48,", "\n1,nan,"), ["episodes.csv: line 2", "'slots'"]),
    (replace_in("episodes.csv", "\n2,48,", "\n2\n"), ["episodes.csv: line 3", "'slots'"]),
    (replace_in("config.yaml", "algorithm:", "algorithm: ]"), ["config.yaml", "not valid YAML"]),
    (replace_in("eval/default.json", "{", "["), ["default.json", "JSON"]),
    (replace_in("eval/default.json", "policies", "rules"), ["default.json", "field policies is missing"]),
    (change_policy("mean_aou_s", None), ["default.json: ", "policies.greedy.mean_aou_s is missing"]),
    (change_policy("communications", ["few"]), ["policies.greedy.communications = ['few']", "expected finite numbers"]),
    (
        change_policy("aou_over_time_s", [[1.0]]),
        ["policies.greedy.aou_over_time_s = [[1.0]]: expected a list of numbers"],
    ),
    (change_policy("device_communications", [[1, 2]]), ["device_communications has 2 devices"]),
]


@pytest.mark.parametrize(("break_it", "words"), BROKEN)
def test_malformed_run_is_an_input_error(tmp_path: Path, break_it: Callable[[Path], object], words: list[str]) -> None:
    folder = write_run(tmp_path / "results")
    break_it(folder)
    with pytest.raises(InputError) as raised:
        plot_figures([folder], tmp_path / "figures")
    assert all(word in str(raised.value) for word in words), str(raised.value)
    assert "\n" not in str(raised.value)


def test_no_runs_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no run folders"):
        plot_figures([], tmp_path)


def test_a_line_cut_off_while_writing_is_left_out(tmp_path: Path) -> None:
    folder = write_run(tmp_path, evaluation=False)
    with (folder / "episodes.csv").open("a", encoding="utf-8") as file:
        file.write("81,10")
    assert len(read_run(folder).episodes["slots"]) == 80


def test_figures_into_a_file_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    run = write_run(tmp_path / "results", missions=4, evaluation=False)
    with pytest.raises(InputError, match="cannot be written"):
        plot_figures([run], tmp_path / "taken")


# -- missions ------------------------------------------------------------------------------------------


def patrol(scenario: Scenario) -> tuple[World, Recording]:
    """One mission of random moves."""
    world = World(scenario, missions=1, seed=3)
    rng = np.random.default_rng(0)
    snapshots = []
    while not world.done:
        world.step(rng.integers(0, 5, (1, scenario.uavs)))
        snapshots.append(world.snapshot())
    return world, Recording.from_snapshots(snapshots)


def test_trajectories_are_drawn(tmp_path: Path) -> None:
    scenario = Scenario.load("quickstart")
    paths = plot_trajectories(scenario, patrol(scenario)[1], tmp_path, "mission")
    assert [path.name for path in paths] == [
        f"mission-{kind}.{end}" for kind in ("map", "ages") for end in ("png", "pdf")
    ]
    assert all(is_drawn(path) for path in paths if path.suffix == ".png")


def test_recording_counts_communications_as_the_world_does() -> None:
    world, recording = patrol(Scenario.load("quickstart"))
    np.testing.assert_array_equal(recording.communications.sum(axis=0), world.metrics().device_communications[0])


def test_nobody_flies_and_nobody_is_served(tmp_path: Path) -> None:
    scenario = Scenario.load("tiny").replace(rate_min_bit_s=1e9)
    world = World(scenario)
    snapshots = []
    while not world.done:
        world.step(np.zeros((1, scenario.uavs), dtype=np.int64))
        snapshots.append(world.snapshot())
    paths = plot_trajectories(scenario, Recording.from_snapshots(snapshots), tmp_path, "idle")
    assert all(is_drawn(path) for path in paths if path.suffix == ".png")


def test_frame_shows_the_mission() -> None:
    scenario = Scenario.load("tiny")
    world = World(scenario, missions=1, seed=0)
    before = render_frame(scenario, world.layout(), world.snapshot())
    trail = [world.positions[0]]
    for _ in range(4):
        world.step(np.array([[1, 3]]))
        trail.append(world.positions[0])
    after = render_frame(scenario, world.layout(), world.snapshot(), np.stack(trail))
    again = render_frame(scenario, world.layout(), world.snapshot(), np.stack(trail))
    assert before.shape == after.shape == FRAME_SHAPE
    assert after.dtype == np.uint8
    assert (before != after).any()
    np.testing.assert_array_equal(after, again)


# -- style ---------------------------------------------------------------------------------------------


def test_an_algorithm_looks_the_same_in_every_company() -> None:
    alone = style.looks(["mappo"])["mappo"]
    together = style.looks(["vdn", "mappo", "mappo+gamma=0.9", "novel"])
    assert together["mappo"] == alone
    assert together["mappo+gamma=0.9"].colour == alone.colour
    assert together["mappo+gamma=0.9"].dash != alone.dash
    assert len({together[name].colour for name in ("mappo", "vdn", "novel")}) == 3


def test_run_is_what_read_run_gives(tmp_path: Path) -> None:
    run = read_run(write_run(tmp_path))
    assert isinstance(run, Run)
    assert (run.scenario, run.algorithm, run.devices) == ("tiny", "mappo", DEVICES)
    assert set(run.evaluations["default"]) == {"mappo", "greedy", "random"}
