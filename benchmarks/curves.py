"""How long until a policy is good, from the start of the process: ``python -m benchmarks.curves [SECONDS]``.

Side by side, on `paper`: `uavaou train` as it stands, the paper's flat network, and the stock pipeline, which is SB3's
own PPO on SuperSuit's own stage. Writes results/benchmarks/curves.csv, levels.csv and a picture. Each training has the
machine to itself, and is stopped after SECONDS (240) of wall-clock.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.measure import kept_rows, write_rows
from uavaou import evaluate
from uavaou.envs.map import BLACK, BLUE, GREEN, ORANGE
from uavaou.reports import style
from uavaou.scenario import Scenario

SCENARIO = "paper"
STOCK = "SB3's PPO on SuperSuit's stage"
CONTESTANTS: dict[str, list[str]] = {
    "mappo": ["train"],
    "mappo-paper": ["train", "--algorithm", "mappo-paper"],
    STOCK: [
        "--plugin",
        "examples/plain_ppo.py",
        "train",
        "--algorithm",
        "plain-ppo",
        "--backend",
        "supersuit",
        "--set",
        "algorithm.collection=select",
        "--slots",
        "3000000",
    ],
}
EVERY_SLOTS = {"mappo": 50_000, "mappo-paper": 50_000, STOCK: 10_000}
LEVELS = (100.0, 60.0, 50.0, 45.0, 40.0, 38.5, 37.0, 36.3)  # mean AoU, slots
LOOKS = {"mappo": (BLUE, "-"), "mappo-paper": (ORANGE, "--"), STOCK: (GREEN, "-.")}
_LOOK_EVERY_S = 0.05
Row = tuple[str, int, float, float, float]


def trained(name: str, seconds: float, place: Path) -> list[Row]:
    """Train for some seconds; returns the evaluations: slots, seconds since the process began, and ages in slots."""
    command = [
        sys.executable,
        "-m",
        "uavaou",
        *CONTESTANTS[name],
        "--scenario",
        SCENARIO,
        "--quiet",
        "--out",
        str(place),
    ]
    command += ["--set", f"algorithm.evaluate_every_slots={EVERY_SLOTS[name]}"]
    began, process = time.monotonic(), subprocess.Popen(command)
    while not (configs := [*place.glob("*/*/seed-0/config.yaml")]):  # until then, the training's own clock stands still
        time.sleep(_LOOK_EVERY_S)
    before = time.monotonic() - began
    try:
        process.wait(seconds - before)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGTERM)
        process.wait()
    actions = [f"evaluation/mean_aou_{action}_s" for action in ("greedy", "sample")]
    rows = kept_rows(configs[0].with_name("progress.csv"), ["time/slots", "time/wall_s", *actions])
    tau = Scenario.load(SCENARIO).slot_length_s
    return [
        (
            name,
            int(row["time/slots"]),
            before + float(row["time/wall_s"]),
            float(row["evaluation/mean_aou_greedy_s"]) / tau,
            float(row["evaluation/mean_aou_sample_s"]) / tau,
        )
        for row in rows
        if row["evaluation/mean_aou_greedy_s"]
    ]


def times(rows: list[Row]) -> list[tuple[str, float, float | None]]:
    """For each contestant and level the seconds until a policy is there that is as good, None for never."""
    found = []
    for name in dict.fromkeys(row[0] for row in rows):
        own = [(wall_s, min(ages)) for of, _, wall_s, *ages in rows if of == name]
        for level in LEVELS:
            found.append((name, level, next((wall_s for wall_s, age in own if age <= level), None)))
    return found


def write(rows: list[Row], folder: Path) -> None:
    """``curves.csv`` and ``levels.csv``."""
    write_rows(folder / "curves.csv", ("name", "slots", "wall_s", "mean_aou_slots", "sampled_aou_slots"), rows)
    write_rows(folder / "levels.csv", ("name", "mean_aou_slots", "wall_s"), times(rows))


def draw(rows: list[Row], folder: Path) -> None:
    """``curves.png`` and ``.pdf``: AoU on the validation missions against wall-clock, beside planners."""
    planners = {name: evaluate(name, SCENARIO).mean_aou_slots for name in ("best-first", "local-greedy-parts")}
    with style.house_style():
        figure, axes = style.new_axes(3.0)
        for name in dict.fromkeys(row[0] for row in rows):
            own = np.array([(row[2], min(row[3:])) for row in rows if row[0] == name])  # (n, 2)
            colour, dash = LOOKS[name]
            axes.plot(own[:, 0], np.minimum.accumulate(own[:, 1]), dash, color=colour, marker=".", label=name)
        for (name, age), dash in zip(planners.items(), (":", "-"), strict=True):
            axes.axhline(age, color=BLACK, linewidth=0.8, linestyle=dash, label=name)
        axes.set(yscale="log", ylim=(20, 30_000), xlim=(0, None), xlabel="time since the start of the process (s)")
        axes.set_ylabel("mean AoU on the\nvalidation missions (slots)")
        style.label_log_axis(axes.yaxis, 20, 30_000)
        style.legend_below(figure, axes, "the best policy so far; one seed")
        style.save(figure, folder, "curves")


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 240.0
    folder = Path("results/benchmarks")
    rows: list[Row] = []
    for name in CONTESTANTS:
        with tempfile.TemporaryDirectory() as place:
            rows += trained(name, seconds, Path(place))
        write(rows, folder)
        for _, level, wall_s in times(rows)[-len(LEVELS) :]:
            print(f"{name}: {level:g} slots after {'-' if wall_s is None else f'{wall_s:.1f} s'}", flush=True)
    draw(rows, folder)


if __name__ == "__main__":
    main()
