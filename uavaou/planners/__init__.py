"""Policies that are not learned: what a learner has to beat."""

from __future__ import annotations

from uavaou.errors import unknown
from uavaou.planners.base import Planner
from uavaou.planners.greedy import BestFirst, Greedy
from uavaou.planners.simple import Random, Stay

__all__ = ["PLANNERS", "BestFirst", "Greedy", "Planner", "Random", "Stay", "make_planner"]

PLANNERS: dict[str, type[Planner]] = {
    "random": Random,
    "stay": Stay,
    "greedy": Greedy,
    "best-first": BestFirst,
}


def make_planner(name: str) -> Planner:
    """Return the planner of that name.

    Raises:
        InputError: no planner has that name.
    """
    if name not in PLANNERS:
        raise unknown("planner", name, PLANNERS)
    return PLANNERS[name]()
