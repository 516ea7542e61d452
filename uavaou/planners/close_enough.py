"""The close-enough travelling salesman on a grid, by the routing solver of OR-Tools.

As a generalised travelling salesman: a device is visited in one of the cells that serve it, each of which is a node
of the device's group, and nodes of the same cell are no way apart.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_SOLVER = Path(__file__).with_name("routing_process.py")


def close_enough_tours(coverages: list[Bools], time_limit_s: float | None = None) -> list[tuple[Ints, Ints]]:
    """A short closed tour for each coverage, over cells that serve every device that any cell serves.

    Args:
        coverages: whether a stop in a cell serves a device, (X, Y, I) each; at least one does.
        time_limit_s: for all tours together; None ends each at a local optimum, the same on every run.

    Returns:
        Each tour's cells in order, (V, 2), and the device that each is visited for, (V,). A tour starts in a cell of
        the device that has the fewest; that stop serves all others in reach of it, which have none of their own.
    """
    seconds = None if time_limit_s is None else time_limit_s / len(coverages)
    nodes = [_nodes(served) for served in coverages]
    problems = [(np.abs(cells[:, None] - cells).sum(axis=-1), device) for cells, device in nodes]  # (N, N) steps, (N,)
    solved = subprocess.run(  # -P: the folder of the script is no place to import from
        [sys.executable, "-P", str(_SOLVER)], input=pickle.dumps((problems, seconds)), capture_output=True
    )
    if solved.returncode:
        raise RuntimeError(f"OR-Tools ended with {solved.returncode}:\n{solved.stderr.decode(errors='replace')}")
    orders: list[list[int]] = pickle.loads(solved.stdout)
    return [(cells[order], device[order]) for (cells, device), order in zip(nodes, orders, strict=True)]


def _nodes(served: Bools) -> tuple[Ints, Ints]:
    """The cells to choose from, (N, 2), and the device of each, (N,); the tour starts at the first."""
    device, column, row = np.nonzero(np.moveaxis(served, -1, 0))  # (M,) each
    choices = np.bincount(device, minlength=served.shape[-1])  # (I,)
    hardest = np.where(choices > 0, choices, len(device) + 1).argmin()
    own = np.flatnonzero(device == hardest)
    start = own[served[column[own], row[own]].sum(axis=-1).argmax()]  # where it serves most others, too
    at_start = served[column[start], row[start]]  # (I,)
    nodes = np.concatenate([[start], np.flatnonzero(~at_start[device])])  # (N,)
    return np.stack([column, row], axis=1)[nodes], device[nodes]
