"""A fuzz target for everything that reads a stranger's file: ``python tests/fuzz/loaders.py CORPUS -runs=1000000``.

Needs ``pip install atheris``. A loader may answer with what it read or with an InputError of one line; anything else
is a finding. ``python tests/fuzz/loaders.py --seeds CORPUS`` writes the corpus to start from: one valid file of each
kind, which the fuzzer then bends.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["uavaou"]):
    import numpy as np

    from uavaou.algorithms.io import save_load
    from uavaou.algorithms.io.tensor_file import ArrayFile, write_arrays
    from uavaou.algorithms.registry import load_config
    from uavaou.devices_csv import read_devices_csv
    from uavaou.errors import InputError
    from uavaou.family import Family
    from uavaou.reports.figures import read_runs
    from uavaou.runs.checkpoint_header import TrainingProgress, read_header, write_header
    from uavaou.runs.folder import RunConfig, RunFolder
    from uavaou.runs.results import read_evaluation
    from uavaou.scenario import Scenario

PLACE = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))


def _checkpoint(content: bytes) -> None:
    path = PLACE / "last.safetensors"
    path.write_bytes(content)
    file = ArrayFile(path)
    read_header(file)
    for name in file.shapes:
        file.read(name)


def _learner(content: bytes) -> None:
    path = PLACE / "model.safetensors"
    path.write_bytes(content)
    save_load.read_header(ArrayFile(path))


def _scenario(content: bytes) -> None:
    path = PLACE / "scenario.yaml"
    path.write_bytes(content)
    Scenario.load(path)


def _family(content: bytes) -> None:
    path = PLACE / "family.yaml"
    path.write_bytes(content)
    Family.load(path)


def _config(content: bytes) -> None:
    (PLACE / "config.yaml").write_bytes(content)
    RunFolder(PLACE).read_config()


def _devices(content: bytes) -> None:
    (PLACE / "devices.csv").write_bytes(content)
    read_devices_csv(PLACE / "scenario.yaml", {"devices_csv": "devices.csv"}, None)


def _evaluation(content: bytes) -> None:
    path = PLACE / "eval.json"
    path.write_bytes(content)
    read_evaluation(path)


def _episodes(content: bytes) -> None:
    folder = PLACE / "run"
    folder.mkdir(exist_ok=True)
    (folder / "config.yaml").write_text(RunConfig(Scenario.load("tiny"), load_config("mappo"), 0).to_yaml())
    (folder / "episodes.csv").write_bytes(content)
    read_runs([folder])


LOADERS = (_checkpoint, _learner, _scenario, _config, _devices, _evaluation, _episodes, _family)


def read(data: bytes) -> None:
    """Give the rest of the input to the loader that its first byte names."""
    if not data:
        return
    try:
        LOADERS[data[0] % len(LOADERS)](data[1:])
    except InputError as error:
        if "\n" in str(error):
            raise ValueError("more than one line") from error


def write_seeds(folder: Path) -> None:
    """One valid file of each kind, its loader's number before it."""
    folder.mkdir(parents=True, exist_ok=True)
    scenario = Scenario.load("tiny")
    checkpoint, learner = PLACE / "c", PLACE / "l"
    arrays = {"policy.weight": np.ones((2, 3), np.float32), "stream.numpy": np.zeros(4, np.uint32)}
    about = {"class": "MAPPO", "arguments": {}, "layout": {}, "rows": 2}
    write_arrays(checkpoint, arrays, write_header(TrainingProgress()))
    write_arrays(learner, arrays, {"kind": "uavaou learner", "schema": "1", "about": json.dumps(about)})
    seeds = (
        checkpoint.read_bytes(),
        learner.read_bytes(),
        b"base: tiny\nslots: 20\nbandwidth_hz: {low: 15000, high: 2.0e+4}\n",
        RunConfig(scenario, load_config("mappo"), 0).to_yaml().encode(),
        b"x_m,y_m,transmit_power_mw\n120,430,0.5\n710,95,0.8\n",
        b'{"scenario": "tiny", "episodes": 1, "policies": {"mappo": {"mean_aou_s": [1.0], "communications": [2],'
        b' "devices_served": [3]}}}',
        b"mission,slots,wall_s,reward_s,mean_aou_s,communications,devices_served\n1,60,0.1,-3,4.5,6,7\n",
        b"base: tiny\nuavs: {among: [1, 2], weights: [1, 2.5]}\narea_m: {low: 200, high: 500, log: true, share: 0.5}\n",
    )
    for number, content in enumerate(seeds):
        (folder / LOADERS[number].__name__.strip("_")).write_bytes(bytes([number]) + content)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--seeds"]:
        write_seeds(Path(sys.argv[2]))
    else:
        atheris.Setup(sys.argv, read)
        atheris.Fuzz()
