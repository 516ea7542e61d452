"""The certificate of a bound: the scenario, the devices and the multipliers that prove it, in one file.

The file is a NumPy archive (``.npz``). Whoever reads it needs nothing of this package: the multipliers are those of
:mod:`uavaou.planners.bound`, and dynamic programming gives their bound. A search for the bound can go on from it.
"""

import json
import zipfile
from pathlib import Path

import numpy as np

from uavaou.arrays import Floats
from uavaou.errors import InputError
from uavaou.files import replacing, writing
from uavaou.planners.bound import Bound
from uavaou.planners.decomposition import price_tables
from uavaou.scenario import Layout, Scenario
from uavaou.world.flight import STEP_OF_MOVE

_MULTIPLIER = "multiplier_"  # before the names of multipliers
_UNREADABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile)


def write_certificate(path: Path, scenario: Scenario, layout: Layout, bound: Bound) -> None:
    """Write the file, replacing what is there, and make its folder.

    Raises:
        InputError: it cannot be written.
    """
    arrays = {_MULTIPLIER + name: values for name, values in bound.multipliers.items()} | vars(layout)
    fields = json.dumps(scenario.to_dict())
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, "wb") as file:
            np.savez_compressed(file, scenario=fields, method=bound.method, mean_aou_s=bound.mean_aou_s, **arrays)


def read_certificate(path: Path, scenario: Scenario) -> Bound:
    """Read the bound of a scenario.

    Raises:
        InputError: the file cannot be read, is no certificate, or is that of another scenario.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            content = {name: file[name] for name in file.files}
        fields, method = json.loads(str(content["scenario"])), str(content["method"])
        mean_aou_s = float(content["mean_aou_s"])
    except _UNREADABLE as error:
        raise InputError(f"'{path}' is not a certificate of uavaou gap, or is damaged") from error
    if fields != json.loads(json.dumps(scenario.to_dict())):
        raise InputError(f"'{path}' is the certificate of another scenario than '{scenario.name}' with these values")
    multipliers = {name.removeprefix(_MULTIPLIER): content[name] for name in content if name.startswith(_MULTIPLIER)}
    if not _fit(scenario, method, multipliers):
        raise InputError(f"'{path}' is damaged: its multipliers do not fit scenario '{scenario.name}'")
    return Bound(mean_aou_s, method, multipliers)


def _fit(scenario: Scenario, method: str, multipliers: dict[str, Floats]) -> bool:
    """Return whether a search can go on from these multipliers; those of the other methods are found anew."""
    layout = scenario.draw_layout()
    tables = int(price_tables(scenario, layout).max()) + 1
    cells, moves = scenario.columns * scenario.rows, len(STEP_OF_MOVE)
    shapes: dict[str, tuple[int, ...]] = {"prices": (tables, scenario.uavs, scenario.devices, cells, moves)}
    if method == "copies":
        shapes["charges"] = (scenario.slots, scenario.devices)
        phases = min(int(layout.update_period.max()), scenario.slots + 1)
        gaps = multipliers.get("differences", np.empty(0)).shape[-1]  # any number from 2 on
        shapes["differences"] = (phases, scenario.uavs, scenario.devices, max(gaps, 2))
    found = {name: values.shape for name, values in multipliers.items()}
    finite = all(values.dtype == np.float64 and np.isfinite(values).all() for values in multipliers.values())
    return finite and (method not in ("fleet", "copies") or found == shapes)
