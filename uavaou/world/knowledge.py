"""What a policy reads in flight: each policy says it, and every table shows it (docs/reference/planners.md).

Only ``everything`` goes beyond what a fleet could have on board: it is the World itself, with every true age and the
present channel of every UAV. What is used before take-off does not count: a plan may be made of the whole map.
"""

from typing import Literal, cast, get_args

from uavaou.errors import InputError, unknown

Knowledge = Literal[
    "nothing",  # the clock and the own position: chance, or routes that were planned before take-off
    "location",  # the own position; the state of the paper
    "local",  # what a UAV measures itself: allowed moves, devices in range now, when it last collected each one itself
    "shared",  # also the positions of all UAVs and every true age; with links, what messages told it of them
    "everything",  # also the present channel of every UAV, and the choices of the UAVs that choose before
]
LEVELS: tuple[Knowledge, ...] = get_args(Knowledge)  # each holds those before it
LIMITS: tuple[Knowledge, ...] = ("local", "shared", "everything")  # that a user may set


def knowledge(policy: object) -> Knowledge:
    """Return what a policy, or a class of policies, reads; one without an attribute ``knows`` may read everything."""
    return getattr(policy, "knows", "everything")


def within(known: Knowledge, limit: str) -> bool:
    """Whether a policy that reads ``known`` reads no more than the ``limit``, which is one of ``LIMITS``."""
    return known in LEVELS[: LEVELS.index(limit) + 1]


def check_within(name: str, known: Knowledge, limit: str) -> None:
    """Refuse the policy called ``name`` that reads more than the ``limit``.

    Raises:
        InputError: it does, or there is no such limit.
    """
    if limit not in LIMITS:
        raise unknown("knows", limit, LIMITS)
    if not within(known, limit):
        raise InputError(f"'{name}' knows {known} in flight, which --knows {limit} does not allow")


def observed(observation: str) -> Knowledge:
    """Return what a learner with this observation reads; ``part`` is ``local`` about some of the devices."""
    return "local" if observation == "part" else cast(Knowledge, level(observation))


def level(observation: str, draw: int = 1) -> str:
    """Return what UAVs observe in a draw of a family: with ``mixed``, ``local`` in even draws, ``shared`` in others.

    In flight, such a policy has ``shared``, or ``local`` as in draw 0.
    """
    return ("local", "shared")[draw % 2] if observation == "mixed" else observation
