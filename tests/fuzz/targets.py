"""Every reader of a stranger's file as a fuzz target, a valid file of each kind, and mutations that know the formats.

A reader may answer with what it read, or with an InputError of one line; anything else is a finding.
"""

import io
import json
import marshal
import random
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import shapely

from tests.field.look_alikes import TEXTS as FIELD_TEXTS
from tests.field.look_alikes import packed_kml, workbook
from uavaou import Family, InputError, RunConfig, Scenario, zoo
from uavaou.algorithms.io.save_load import LearnerHeader
from uavaou.algorithms.io.tensor_file import ArrayFile, write_arrays
from uavaou.algorithms.registry import load_config
from uavaou.devices_csv import read_devices_csv
from uavaou.errors import all_faults
from uavaou.evaluation.recorded_mission import read_mission
from uavaou.experiments.search import Arm, Search, SearchFolder, Stage
from uavaou.experiments.search_space import SearchSpace
from uavaou.experiments.study import Study
from uavaou.experiments.suite import Suite
from uavaou.field.features import Feature, Reading
from uavaou.field.folder import scenario_of
from uavaou.field.mission import Wishes, lay_out
from uavaou.field.read import read_file
from uavaou.field.survey import understand
from uavaou.onboard import runner
from uavaou.plain_yaml import parse_yaml
from uavaou.planners.saved import load_planner
from uavaou.reports.figures import read_runs
from uavaou.reports.suites import read_suites
from uavaou.runs import folder
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import EPISODE_COLUMNS, RunFolder
from uavaou.runs.records import EpisodesCsv, ProgressCsv
from uavaou.zoo import zoo_path
from uavaou_cli.overrides import parse_overrides

ODD = (
    *("!!int '2'", "!!bool foo", "!!timestamp foo", "!!binary x", "! 3", "&a [*a]", "*a", "<<: {a: 1}", "? x", "- - -"),
    *("010", "1:1", "1:1.5", "1e999", ".inf", ".nan", "-0.0", "0x1F", "1e-400", "9" * 400, "9" * 40, "-1", "0", "2.5"),
    *("true", "null", "''", "[]", "{}", "[[[]]]", "{low: 1}", "nan", "inf", "1_000", "1e3", "%YAML 2.0", "---", "..."),
    *("/dev/zero", "../x.csv", "devices.csv", "tiny", "\u2028", "\x00", "\ud7ff", '"\\ud800"', "é" * 50, "x" * 5000),
    *(",", '"', "\r", "[", "{"),
)


CORPUS = Path(__file__).with_name("corpus")  # READER/NAME: files that reached code which the seeds do not


def corpus() -> Iterator[tuple[str, Path]]:
    """The committed files, each with the reader that it is for."""
    for name in READERS:
        for path in sorted((CORPUS / name).glob("*")):
            if path.is_file():
                yield name, path


@cache
def place() -> Path:
    """A folder in memory, where there is one."""
    return Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))


@cache
def _path(name: str) -> Path:
    """Where a reader finds its file: in a folder of its own."""
    path = place() / name.replace("/", "-") / Path(name).name
    path.parent.mkdir()
    return path


def settle() -> None:
    """Read once what is the same in all executions: shipped files, and what lies beside the file that is new.

    It lasts as long as the process.
    """
    shipped = str(zoo.zoo_folder("")) + "/"
    parse, read_config = zoo.parse_yaml, folder.read_config
    beside = _path("run/episodes.csv").with_name("config.yaml")

    @cache
    def known(text: str, source: str) -> bytes:
        return marshal.dumps(parse(text, source))

    def parsed(text: str, source: str) -> Any:
        return marshal.loads(known(text, source)) if source.startswith(shipped) else parse(text, source)

    patch.object(zoo, "parse_yaml", parsed).start()
    patch.object(zoo, "zoo_names", cache(zoo.zoo_names)).start()
    patch.object(folder, "read_config", lambda path: config() if path == beside else read_config(path)).start()


@cache
def config() -> RunConfig:
    return RunConfig(Scenario.load("tiny"), load_config("mappo-paper"), 0)


def _checkpoint(path: Path) -> None:
    file = ArrayFile(path)
    TrainingProgress.read(file)
    for name in file.shapes:
        file.read(name)


def _episodes(path: Path) -> None:
    if not (beside := path.with_name("config.yaml")).exists():
        beside.write_text(config().to_yaml())
    read_runs([path.parent])


def _rows(path: Path) -> None:
    kept = path.read_bytes()
    for table in (EpisodesCsv, ProgressCsv):
        path.write_bytes(kept)
        table(path, 1, "0" * 64).close()


def _devices(path: Path) -> None:
    read_devices_csv(path.with_name("s.yaml"), {"devices_csv": path.name}, None, faults := [])
    if faults:
        raise all_faults("devices", faults)


def _overrides(path: Path) -> None:
    overrides = parse_overrides(path.read_bytes().decode("utf-8", "surrogateescape").split("\n"))
    overrides.of_scenario(config().scenario)
    overrides.of_algorithm("mappo")


class _Graph:
    """In place of policy.onnx, which onnxruntime checks: logits of eight devices."""

    def __init__(self, *_: Any) -> None: ...

    def run(self, _: None, rows: dict[str, Any]) -> list[Any]:
        return [np.zeros((1, 5), np.float32), np.zeros((1, rows.get("devices", np.zeros((1, 8))).shape[1]), np.float32)]


def _onboard(path: Path) -> None:
    """Fly two slots by what was exported, of which one file is new."""
    other = path.with_name("mission.json" if path.name == "policy.json" else "policy.json")
    if not other.exists():
        other.write_bytes(seeds()[f"onboard/{other.name}"])
    with patch.object(runner.onnxruntime, "InferenceSession", _Graph):
        try:
            pilot = runner.Pilot(path.parent, 0)
        except ValueError as error:  # on board, there is no InputError
            raise InputError(str(error)) from error
    devices, mates = len(pilot.devices), len(pilot.others)
    for _ in range(2):
        if not pilot.done and devices == 8:
            pilot.decide(pilot.cds[0] * pilot.step, np.ones(devices), np.zeros((mates, 2)))
            pilot.end_slot(np.zeros(devices, int))


def _field(path: Path) -> None:
    """Lay out a field from a file of the outside world beside three devices, as it may hold a border alone."""
    beside = Reading(path, [Feature(shapely.Point(7.22 + k / 500, 46.1), f"line {k}") for k in range(3)])
    found = lay_out(understand([read_file(path), beside]), Wishes(), lambda scenario: np.full((1, 3), 250.0))
    scenario_of(found, [path])


READERS: dict[str, Callable[[Path], Any]] = {
    "checkpoint.safetensors": _checkpoint,
    "learner.safetensors": lambda path: LearnerHeader.read(ArrayFile(path)),
    "scenario.yaml": Scenario.load,
    "config.yaml": lambda path: RunFolder(path.parent).read_config(),
    "devices.csv": _devices,
    "run/episodes.csv": _episodes,
    "family.yaml": Family.load,
    "study.yaml": Study.load,
    "suite.yaml": lambda path: Suite.load(str(path)),
    "space.yaml": partial(SearchSpace.load, "mappo"),
    "search/search.yaml": lambda path: SearchFolder(path.parent).read(),
    "mission.json": read_mission,
    "plan.json": load_planner,
    "rule/plan.json": load_planner,
    "suite.csv": lambda path: read_suites([path]),
    "rows.csv": _rows,
    "set.txt": _overrides,
    "onboard/policy.json": _onboard,
    "onboard/mission.json": _onboard,
    "any.yaml": lambda path: parse_yaml(path.read_bytes().decode("utf-8", "replace"), "f"),
    **dict.fromkeys(
        (
            "field/map.geojson",
            "field/map.kml",
            "field/map.gpx",
            "field/map.kmz",
            "field/mission.plan",
            "field/list.wpl",
        ),
        _field,
    ),
    **dict.fromkeys(("field/table.csv", "field/book.xlsx", "field/records.json"), _field),
}


@cache
def seeds() -> dict[str, bytes]:
    """A valid file for each reader."""
    tiny, mappo = config().scenario, config().algorithm
    files = {name: place() / f"seed-{name.replace('/', '-')}" for name in READERS}
    arrays = {"policy.weight": np.ones((2, 3), np.float32), "stream.numpy": np.zeros(4, np.uint32)}
    about = {"class": "MAPPO", "arguments": {}, "layout": {}, "rows": 2}
    write_arrays(files["checkpoint.safetensors"], arrays, TrainingProgress().text())
    learner = {"schema": "2", "about": json.dumps(about)}
    write_arrays(files["learner.safetensors"], arrays, learner)
    slots, uavs, devices = tiny.slots, tiny.uavs, tiny.devices
    cells = np.rint(np.asarray(tiny.cds_m) / tiny.grid_step_m).astype(int).tolist()
    layout = {
        "devices_m": [[0, 0]] * devices,
        **dict.fromkeys(("bandwidth_hz", "transmit_power_w", "update_period_slots"), [1] * devices),
    }
    mission = {
        "schema": 1,
        "policy": "p",
        "training_seed": 0,
        "mission_seed": 1,
        "scenario": tiny.to_dict(),
        "layout": layout,
        "positions_m": [[[0, 0]] * uavs] * slots,
        "collected_by": [[-1] * devices] * slots,
        "age_sum_slots": [[1] * devices] * slots,
    }
    plan = {"planner": "tour", "scenario": tiny.to_dict(), "mean_aou_s": 1.0, "bound_s": None, "interrupted": False}
    search = Search(tiny, 0, {"mappo": Arm.of(mappo, ())}, (Stage(trials=3, slots=500),))
    texts = {
        "scenario.yaml": "base: tiny\nslots: 20\nbandwidth_hz: {low: 15000, high: 2.0e+4}\ndevices_csv: devices.csv\n",
        "config.yaml": config().to_yaml(),
        "devices.csv": "x_m,y_m,transmit_power_mw\n120,430,0.5\n710,95,0.8\n",
        "run/episodes.csv": ",".join(EPISODE_COLUMNS) + "\n1,60,0.1,-3,4,6,7\n",
        "family.yaml": "base: tiny\nuavs: {among: [1, 2], weights: [1, 2.5]}\narea_m: {low: 200, high: 500}\n",
        "study.yaml": zoo_path("studies", "smoke").read_text(),
        "suite.yaml": "description: d\nscenario: tiny\naxis: {label: x}\npoints: [{label: a, x: 0, set: {slots: 9}}]\n",
        "space.yaml": zoo_path("tuning", "mappo").read_text(),
        "search/search.yaml": search.to_yaml(),
        "mission.json": json.dumps(mission),
        "plan.json": json.dumps(plan | {"routes": [[cell] * slots for cell in cells]}),
        "rule/plan.json": json.dumps(plan | dict.fromkeys(("weight", "reach", "share"), [[0.5] * devices] * uavs)),
        "suite.csv": (
            "suite,axis,scale,joined,point,x,policy,how,seed,mission_seed,mean_aou_slots\n"
            "s,x,linear,yes,1,1,mappo,trained,0,7,3\ns,x,linear,yes,1,1,best-first,planner,,7,30\n"
        ),
        "rows.csv": "mission,slots\n1,2\n3,4\n",
        "set.txt": "scenario.bandwidth_hz.low=14e3\nscenario.slots=9\nalgorithm.hidden=[8, 8]",
        "any.yaml": "a: {b: [1, 2.5, x], 'c': true}\nd:\n  - e: null\n",
    }
    texts |= {f"field/{name}": text for name, text in FIELD_TEXTS.items()}
    for name, write in (("kmz", packed_kml), ("xlsx", workbook)):
        kind = next(reader for reader in READERS if reader.endswith(name))
        files[kind].write_bytes(write())
    for name, text in texts.items():
        files[name].write_text(text, encoding="utf-8")
    for name, kept in (("policy", "flat"), ("mission", "quickstart")):
        files[f"onboard/{name}.json"] = CORPUS / "onboard" / f"{name}.json" / kept
    return {name: path.read_bytes() for name, path in files.items()}


def read(name: str, content: bytes) -> None:
    """Give content to the reader of that file's name.

    Raises:
        Exception: a finding.
    """
    try:
        path = _path(name)
        path.write_bytes(content)
        READERS[name](path)
    except InputError as error:
        if "\n" in str(error):
            raise ValueError("more than one line") from error


def mutated(name: str, content: bytes, rng: random.Random) -> bytes:
    """A file like ``content``, with one to three changes where its format has parts."""
    header = 0
    if content.startswith(b"PK") and rng.random() < 0.8:
        return _repacked(content, rng)
    if name.endswith(".safetensors") and rng.random() < 0.7:  # inside of the header, whose length then fits
        header = int.from_bytes(content[:8], "little")
        changed = content[8 : 8 + header]
        for _ in range(rng.randint(1, 3)):
            changed = _change(changed, rng)
        return len(changed).to_bytes(8, "little") + changed + content[8 + header :]
    for _ in range(rng.randint(1, 3)):
        content = _change(content, rng)
    return content


def _repacked(content: bytes, rng: random.Random) -> bytes:
    """An archive with another content of one of its files."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        parts = {part: archive.read(part) for part in archive.namelist()}
    chosen = rng.choice(list(parts))
    parts[chosen] = _change(parts[chosen], rng)
    with zipfile.ZipFile(file := io.BytesIO(), "w") as archive:
        for part, inner in parts.items():
            archive.writestr(part, inner)
    return file.getvalue()


def _change(content: bytes, rng: random.Random) -> bytes:
    """Another token, line, bit or end."""
    odd = rng.choice(ODD).encode("utf-8", "replace")
    kind = rng.choice(("token", "token", "token", "line", "bit", "cut", "insert"))
    if kind == "token":
        ends = [k for k, byte in enumerate(content) if byte in b" ,:[]{}\n\"'="] or [0]
        first = rng.choice(ends)
        last = next((end for end in ends if end > first), len(content))
        return content[: first + 1] + (b" " if rng.random() < 0.5 else b"") + odd + content[last:]
    if kind == "line":
        lines = content.split(b"\n")
        k = rng.randrange(len(lines))
        lines[k:k] = [rng.choice(lines)] if rng.random() < 0.5 else [b"key: " + odd]
        return b"\n".join(lines)
    at = rng.randrange(len(content) + 1)
    if kind == "cut":
        return content[:at]
    if kind == "insert" or at == len(content):
        return content[:at] + odd + content[at:]
    return content[:at] + bytes([content[at] ^ (1 << rng.randrange(8))]) + content[at + 1 :]
