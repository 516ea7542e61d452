"""The routing solver of OR-Tools in its own process: a script that reads pickled problems and writes pickled orders.

The wheels of OR-Tools and of HiGHS each contain a ``libhighs``, and a process fails to load the second of them
(google/or-tools#5246). So no other module imports OR-Tools, and this one imports nothing of the package.
"""

import pickle
import sys

import numpy as np
from numpy.typing import NDArray
from ortools.constraint_solver import pywrapcp
from ortools.constraint_solver.routing_enums_pb2 import FirstSolutionStrategy, LocalSearchMetaheuristic

Ints = NDArray[np.int64]

_SKIPPED = 10**6  # cost of a group without a visit; more than the length of any tour


def order(distances: Ints, group: Ints, time_limit_s: float | None) -> list[int]:
    """Return a short closed tour from node 0 through one node of each group.

    Args:
        distances: (N, N).
        group: the group of each node, (N,); node 0 is visited whatever its group.
        time_limit_s: duration of a guided local search beyond the first local optimum; None ends at that local
            optimum, which is the same on every run.
    """
    manager = pywrapcp.RoutingIndexManager(len(distances), 1, 0)
    routing = pywrapcp.RoutingModel(manager)
    routing.SetArcCostEvaluatorOfAllVehicles(routing.RegisterTransitMatrix(distances.tolist()))
    for visited in np.unique(group[1:]):
        choices = 1 + np.flatnonzero(group[1:] == visited)
        routing.AddDisjunction([manager.NodeToIndex(int(node)) for node in choices], _SKIPPED)
    parameters = pywrapcp.DefaultRoutingSearchParameters()
    parameters.first_solution_strategy = FirstSolutionStrategy.PATH_CHEAPEST_ARC
    parameters.local_search_metaheuristic = LocalSearchMetaheuristic.GREEDY_DESCENT
    if time_limit_s is not None:
        parameters.local_search_metaheuristic = LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
        parameters.time_limit.FromMilliseconds(max(1, int(1000 * time_limit_s)))
    solution = routing.SolveWithParameters(parameters)
    nodes, index = [], routing.Start(0)
    while not routing.IsEnd(index):
        nodes.append(manager.IndexToNode(index))
        index = solution.Value(routing.NextVar(index))
    return nodes


if __name__ == "__main__":
    problems, seconds = pickle.load(sys.stdin.buffer)
    pickle.dump([order(distances, group, seconds) for distances, group in problems], sys.stdout.buffer)
