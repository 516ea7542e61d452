"""OR-Tools' routing solver in a process of its own: run as a script, pickled problems in, pickled orders out.

The wheels of OR-Tools and of HiGHS each bring a ``libhighs``, and whichever of them a process loads second fails to
load (google/or-tools#5246). So no other module imports OR-Tools, and this one imports nothing of the package.
"""

from __future__ import annotations

import pickle
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ortools.constraint_solver import pywrapcp
from ortools.constraint_solver.routing_enums_pb2 import FirstSolutionStrategy, LocalSearchMetaheuristic

Ints = NDArray[np.int64]

_LEFT_OUT = 10**6  # cost of a group without a visit; more than any tour's length


def order(away: Ints, group: Ints, time_limit_s: float | None) -> list[int]:
    """A short closed tour from node 0 over one node of each group of the others.

    Args:
        away: lengths, (N, N).
        group: that each node is in, (N,); node 0 is visited whatever its group.
        time_limit_s: searches beyond the first local optimum, by guided local search, for that long; None ends
            at the local optimum, which is the same on every run.
    """
    manager = pywrapcp.RoutingIndexManager(len(away), 1, 0)
    routing = pywrapcp.RoutingModel(manager)
    routing.SetArcCostEvaluatorOfAllVehicles(routing.RegisterTransitMatrix(away.tolist()))
    for visited in np.unique(group[1:]):
        choices = 1 + np.flatnonzero(group[1:] == visited)
        routing.AddDisjunction([manager.NodeToIndex(int(node)) for node in choices], _LEFT_OUT)
    solution = routing.SolveWithParameters(_parameters(time_limit_s))
    nodes, index = [], routing.Start(0)
    while not routing.IsEnd(index):
        nodes.append(manager.IndexToNode(index))
        index = solution.Value(routing.NextVar(index))
    return nodes


def _parameters(time_limit_s: float | None) -> Any:
    parameters = pywrapcp.DefaultRoutingSearchParameters()
    parameters.first_solution_strategy = FirstSolutionStrategy.PATH_CHEAPEST_ARC
    parameters.local_search_metaheuristic = LocalSearchMetaheuristic.GREEDY_DESCENT
    if time_limit_s is not None:
        parameters.local_search_metaheuristic = LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
        parameters.time_limit.FromMilliseconds(max(1, int(1000 * time_limit_s)))
    return parameters


if __name__ == "__main__":
    problems, seconds = pickle.load(sys.stdin.buffer)
    pickle.dump([order(away, group, seconds) for away, group in problems], sys.stdout.buffer)
