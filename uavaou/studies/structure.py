"""The structure of a training: which devices its team holds; which trainings stray from it; when that is decided.

A device is **held** where it has the shortest update period of its layout and is collected in at least ``HELD`` of the
slots in which it has a new update: some UAV is then within range of it in nearly every such slot. The held devices are
counted from the communications of the final evaluation, ``devices.csv``. A training **strays** where it does not hold
the devices that the study states as ``held``; or where its mean AoU is more than the fraction that the study states as
``behind`` above the lowest of its algorithm on the scenario. A study that states neither calls strays those that do not
hold the commonest set of held devices among the trainings on the scenario that hold any.
"""

from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from uavaou.statistics.counts import is_decided
from uavaou.studies.folder import PartKey
from uavaou.studies.results import StudyResults, Table

HELD = 0.9


class Structure(NamedTuple):
    """What the team of a training does."""

    held: tuple[int, ...]  # devices
    strays: bool


def held_devices(devices: Table, slots: int) -> tuple[int, ...]:
    """The devices that a policy holds.

    Args:
        devices: the rows of ``devices.csv`` of the policy.
        slots: of a mission, K.
    """
    period = devices["update_period_slots"]  # (I,)
    share = devices["communications"] * period / slots  # (I,) of the slots with a new update
    return tuple(devices["device"][(period == period.min()) & (share >= HELD)].tolist())


def structures(results: StudyResults) -> dict[PartKey, Structure]:
    """The structure of each training whose layout is fixed, by scenario and then in the tables' order."""
    found: dict[PartKey, Structure] = {}
    stated, behind = results.settings.get("held"), results.settings.get("behind")
    for scenario, fields in results.scenarios.items():
        keys = [key for key, rows in results.parts.items() if key.seed is not None and "devices" in rows]
        held = {
            key: held_devices(results.table("devices", *key), fields["slots"])
            for key in keys if key.scenario == scenario
        }  # fmt: skip
        if isinstance(stated, list):
            found |= {key: Structure(own, not set(stated) <= set(own)) for key, own in held.items()}
        elif isinstance(behind, float | int):
            found |= {key: Structure(own, _ratio(results, key) > 1 + behind) for key, own in held.items()}
        elif held:
            # Of equally common ones, the one of more devices.
            holding = Counter(own for own in held.values() if own)
            commonest = max(holding.items(), key=lambda pair: (pair[1], len(pair[0])), default=((), 0))[0]
            found |= {key: Structure(own, own != commonest) for key, own in held.items()}
    return found


def _ratio(results: StudyResults, key: PartKey) -> float:
    """The mean AoU of a training, in units of the lowest of its algorithm on the scenario."""
    algorithms = results.algorithms
    means = {
        other: float(results.cell(other, "mean_aou_slots"))
        for other in results.parts
        if other.seed is not None and other.scenario == key.scenario
    }
    same = [mean for other, mean in means.items() if algorithms[other.variant] == algorithms[key.variant]]
    return means[key] / min(same)


def strays(found: Mapping[PartKey, Structure], variant: str, scenario: str) -> tuple[int, int]:
    """How many trainings of a variant stray, and how many there are."""
    own = [one.strays for key, one in found.items() if key[:2] == (variant, scenario)]
    return int(np.sum(own, dtype=int)), len(own)


def not_needed(results: StudyResults, settings: Mapping[str, Any]) -> set[PartKey]:
    """The trainings that cannot change a verdict any more, in a study that goes on until that is decided.

    Each variant is tested against the reference: Fisher's test on strays, after all seeds of both.

    Args:
        results: so far.
        settings: the content of ``study.yaml``.
    """
    reference, seeds = settings.get("reference"), settings.get("seeds") or []
    if not settings.get("until_decided") or not isinstance(reference, str):
        return set()
    stated = StudyResults(results.folder, dict(settings), results.parts)
    found, unneeded = structures(stated), set()
    for scenario in settings.get("scenarios") or ():
        own = strays(found, reference, scenario)
        others = [name for name in settings.get("variants") or () if name != reference]
        decided = [name for name in others if is_decided(*own, *strays(found, name, scenario), len(seeds))]
        ended = [*decided, *([reference] if len(decided) == len(others) else [])]
        unneeded |= {PartKey(name, scenario, seed) for name in ended for seed in seeds} - results.parts.keys()
    return unneeded
