"""How long until a training is good, ``python -m benchmarks.curves [SECONDS]``: both collections, one core and two.

Writes results/benchmarks/curves.csv and a picture of it. Each training has the machine to itself, a thread a core, and
is stopped after SECONDS (240) of wall-clock.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from uavaou import evaluate
from uavaou.csv_tables import read_csv, write_csv
from uavaou.envs.map import BLACK, BLUE, ORANGE
from uavaou.reports import style
from uavaou.scenario import Scenario

SCENARIO = "paper"
EVERY_SLOTS = 50_000
COLUMNS = ("collection", "cores", "slots", "wall_s", "mean_aou_slots", "sampled_aou_slots")
Row = tuple[str, int, int, float, float, float]


def trained(collection: str, cores: int, seconds: float, place: Path) -> Path:
    """Train for some seconds; returns progress.csv."""
    settings = [f"algorithm.evaluate_every_slots={EVERY_SLOTS}", f"algorithm.collection={collection}"]
    command = [sys.executable, "-c", "import sys; from uavaou_cli.main import main; sys.exit(main())", "train"]
    command += ["--scenario", SCENARIO, "--quiet", "--out", str(place), "--threads", str(cores)]
    for setting in settings:
        command += ["--set", setting]
    process = subprocess.Popen(command)
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGTERM)
        process.wait()
    return next(place.glob("*/*/seed-0/progress.csv"))


def points(collection: str, cores: int, progress: Path) -> list[Row]:
    """The evaluations of a training; ages in slots."""
    tau = Scenario.load(SCENARIO).slot_length_s
    table = read_csv(progress)
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    return [
        (
            collection, cores, int(row["time/slots"]), float(row["time/wall_s"]),
            float(row["evaluation/mean_aou_greedy_s"]) / tau, float(row["evaluation/mean_aou_sample_s"]) / tau,
        )
        for row in rows
        if row["evaluation/mean_aou_greedy_s"]
    ]  # fmt: skip


def write(rows: list[Row], folder: Path) -> None:
    """``curves.csv``."""
    write_csv(folder / "curves.csv", COLUMNS, rows)


def draw(rows: list[Row], folder: Path) -> None:
    """``curves.png`` and ``.pdf``: AoU on the validation missions against wall-clock, beside `greedy`."""
    scenario = Scenario.load(SCENARIO)
    greedy = evaluate("greedy", scenario).mean_aou_s / scenario.slot_length_s
    looks = {"select": BLUE, "auto": ORANGE}  # which differ in grey too
    with style.house_style():
        figure, axes = style.new_axes(3.0)
        for collection, cores in dict.fromkeys(row[:2] for row in rows):
            own = np.array([row[3:5] for row in rows if row[:2] == (collection, cores)])  # (n, 2)
            label = f"{collection}, {cores} core{'s' if cores > 1 else ''}"
            axes.plot(*own.T, "-" if cores > 1 else "--", color=looks[collection], label=label)
        axes.axhline(greedy, color=BLACK, linewidth=0.8, linestyle=":", label="greedy, and half of it")
        axes.axhline(greedy / 2, color=BLACK, linewidth=0.8, linestyle=":")
        axes.set(yscale="log", ylim=(30, 1000), xlim=(0, None), xlabel="wall-clock time of training (s)")
        axes.set_ylabel("mean AoU on the\nvalidation missions (slots)")
        style.label_log_axis(axes.yaxis, 30, 1000)
        style.legend_below(figure, axes, "likeliest action; one seed")
        style.save(figure, folder, "curves")


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 240.0
    folder = Path("results/benchmarks")
    rows: list[Row] = []
    for collection in ("select", "auto"):
        for cores in (1, 2):
            with tempfile.TemporaryDirectory() as place:
                rows += points(collection, cores, trained(collection, cores, seconds, Path(place)))
            write(rows, folder)
    draw(rows, folder)


if __name__ == "__main__":
    main()
