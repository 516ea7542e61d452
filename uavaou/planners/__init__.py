"""Policies that are not learned: the references for a learner."""

from pkgutil import resolve_name

from uavaou.errors import InputError, unknown
from uavaou.planners.base import Planner
from uavaou.scenario import Scenario
from uavaou.world.knowledge import Knowledge, check_within, knowledge

__all__ = [
    "PLANNERS",
    "PLANNERS_WITH_PLAN",
    "PLAN_AHEAD",
    "Planner",
    "gap_planners",
    "make_planner",
    "planner_knowledge",
]

# Each loads on first use: importing a compiler or a solver takes longer than most missions.
PLANNERS: dict[str, str] = {
    "random": "uavaou.planners.base:Random",
    "stay": "uavaou.planners.base:Stay",
    "greedy": "uavaou.planners.greedy:Greedy",
    "best-first": "uavaou.planners.greedy:BestFirst",
    "local-greedy": "uavaou.planners.local_greedy:LocalGreedy",
    "local-greedy-parts": "uavaou.planners.local_greedy:LocalGreedyParts",
    "local-greedy-tuned": "uavaou.planners.tuned:LocalGreedyTuned",
    "tour": "uavaou.planners.tour:Tour",
    "partition-tour": "uavaou.planners.tour:PartitionTour",
    "anneal": "uavaou.planners.anneal:Anneal",
    "rolling": "uavaou.planners.rolling:Rolling",
    "exact": "uavaou.planners.exact:Exact",
}
# Planners that plan before take-off and take a time limit. ``uavaou plan`` writes down what all but one have found.
PLANNERS_WITH_PLAN = ("tour", "partition-tour", "anneal", "exact", "local-greedy-tuned")
PLAN_AHEAD = (*PLANNERS_WITH_PLAN, "rolling")


def make_planner(name: str, time_limit_s: float | None = None, knows: str = "everything") -> Planner:
    """Return the planner of that name.

    Args:
        name: one of ``PLANNERS``.
        time_limit_s: of the planning before take-off, for ``PLAN_AHEAD``.
        knows: the most that it may read in flight.

    Raises:
        InputError: no planner has that name, one without planning before take-off is given a time limit, or it needs to
            know more.
    """
    if name not in PLANNERS:
        raise unknown("planner", name, PLANNERS)
    check_within(name, planner_knowledge(name), knows)
    if time_limit_s is not None and name not in PLAN_AHEAD:
        raise InputError(f"planner '{name}' decides slot by slot and takes no time limit")
    kind = resolve_name(PLANNERS[name])
    planner: Planner = kind() if time_limit_s is None else kind(time_limit_s)
    return planner


def planner_knowledge(name: str) -> Knowledge:
    """What the planner of that name reads in flight."""
    return knowledge(resolve_name(PLANNERS[name]))


def gap_planners(scenario: Scenario) -> list[str]:
    """The planners that show how far a scenario's best policy is from the bound: ``exact`` where it can plan."""
    from uavaou.planners.exact import LARGEST, program_size

    names = ["local-greedy-tuned", "rolling", "anneal", "best-first", "greedy", "local-greedy-parts", "local-greedy"]
    tours = scenario.outline_m is None and scenario.no_fly is None  # they do not lead around zones
    names += ["partition-tour", "tour", "random"] if tours else ["random"]
    solvable = scenario.fading == "none" and program_size(scenario) <= LARGEST
    return ["exact", *names] if solvable else names
