"""The close-enough travelling salesman problem (CETSP) on a grid, solved by the routing solver of OR-Tools.

It is solved as a generalised TSP: each cell that covers a device is a node of that device's group, and the tour visits
one node of each group. Nodes in the same cell have distance 0.
"""

import pickle
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import numpy as np

from uavaou.arrays import Bools, Ints

_SOLVER = Path(__file__).with_name("ortools_process.py")


def close_enough_tours(coverages: list[Bools], time_limit_s: float | None = None) -> list[tuple[Ints, Ints]]:
    """Return a short closed tour for each coverage, over cells that cover every device that any cell covers.

    Args:
        coverages: whether a cell covers a device, (X, Y, I) each; at least one does.
        time_limit_s: for all tours together; None ends each at a local optimum, the same on every run.

    Returns:
        The cells of each tour in order, (V, 2), and the device that each cell is visited for, (V,). A tour starts in a
        cell of the device that has the fewest; that stop also covers all other devices in its reach, which have no
        stop of their own.
    """
    if time_limit_s is not None:
        return _solve(coverages, time_limit_s / len(coverages))
    return _local_optima(tuple((covered.shape, covered.tobytes()) for covered in coverages))


@lru_cache(maxsize=64)  # planners share tours, and a solver process takes longer to start than most tours to find
def _local_optima(coverages: tuple[tuple[tuple[int, ...], bytes], ...]) -> list[tuple[Ints, Ints]]:
    return _solve([np.frombuffer(content, dtype=np.bool_).reshape(shape) for shape, content in coverages], None)


def _solve(coverages: list[Bools], seconds: float | None) -> list[tuple[Ints, Ints]]:
    """Run the solver in its own process, for so many seconds a tour."""
    nodes = [_nodes(covered) for covered in coverages]
    problems = [(np.abs(cells[:, None] - cells).sum(axis=-1), device) for cells, device in nodes]  # (N, N) steps, (N,)
    solved = subprocess.run(  # -P: no import from the script's own folder
        [sys.executable, "-P", str(_SOLVER)], input=pickle.dumps((problems, seconds)), capture_output=True
    )
    if solved.returncode:
        raise RuntimeError(f"OR-Tools ended with {solved.returncode}:\n{solved.stderr.decode(errors='replace')}")
    orders: list[list[int]] = pickle.loads(solved.stdout)
    return [(cells[order], device[order]) for (cells, device), order in zip(nodes, orders, strict=True)]


def _nodes(covered: Bools) -> tuple[Ints, Ints]:
    """Return the candidate cells, (N, 2), and the device of each, (N,); the tour starts at the first."""
    device, column, row = np.nonzero(np.moveaxis(covered, -1, 0))  # (M,) each
    choices = np.bincount(device, minlength=covered.shape[-1])  # (I,)
    hardest = np.where(choices > 0, choices, len(device) + 1).argmin()
    own = np.flatnonzero(device == hardest)
    start = own[covered[column[own], row[own]].sum(axis=-1).argmax()]  # the cell that covers most other devices too
    at_start = covered[column[start], row[start]]  # (I,)
    nodes = np.concatenate([[start], np.flatnonzero(~at_start[device])])  # (N,)
    return np.stack([column, row], axis=1)[nodes], device[nodes]
