"""What if a UAV is lost? Sentences such as ``UAV 2 lost at half time`` as failures of a scenario."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import product

from uavaou.errors import InputError, unknown
from uavaou.fields import short
from uavaou.mission_fields import Failure
from uavaou.scenario import Scenario
from uavaou.units import MisreadText, in_own_units

_SENTENCE = re.compile(r"\s*(.+?)\s+(?:is\s+)?(?:lost|fails|failed)\s+(?:at|in)\s+(.+?)\s*", re.IGNORECASE)
_HALF = re.compile(r"half[\s-]?time|half(?:way)?", re.IGNORECASE)
_SLOT = re.compile(r"slot\s+(\d{1,9})", re.IGNORECASE)
_NUMBERED = re.compile(r"uav[\s_]*(\d{1,9})", re.IGNORECASE)
ONE = "one UAV"
_EXAMPLES = "'UAV 1 lost at half time', 'UAV 1 lost at 30 min' or 'uav_1 lost at slot 100'"


def what_if(scenario: Scenario, sentences: Iterable[str]) -> Scenario:
    """Return the scenario in which this happens too.

    Raises:
        InputError: a sentence is none, or names a UAV or a slot that there is not.
    """
    failures = [_failure(scenario, *_parts(sentence), sentence) for sentence in sentences]
    return _failing(scenario, failures)


def what_ifs(scenario: Scenario, sentences: Sequence[str]) -> list[tuple[str, Scenario]]:
    """Return what may happen, each with a name: ``one UAV`` stands for each of them in turn.

    Raises:
        InputError: as :func:`what_if`.
    """
    cases = []
    for sentence in sentences:
        who, when = _parts(sentence)
        each = range(scenario.uavs) if who.lower() == ONE.lower() else [None]
        names = [who if u is None else scenario.uav_name(u) for u in each]
        cases.append([(name, _failure(scenario, name, when, sentence)) for name in names])
    found = []
    for case in product(*cases):
        name = " and ".join(name for name, _ in case)
        found.append((name, _failing(scenario, [failure for _, failure in case])))
    return found


def _failing(scenario: Scenario, failures: list[Failure]) -> Scenario:
    if not failures:
        return scenario
    every = [*(scenario.failures or ()), *failures]
    return scenario.replace(failures=[failure.model_dump(exclude_none=True) for failure in every])


def _parts(sentence: str) -> tuple[str, str]:
    found = _SENTENCE.fullmatch(sentence)
    if found is None:
        raise InputError(f"--what-if {short(sentence)}: expected who is lost and when, such as {_EXAMPLES}")
    return found[1], found[2]


def _failure(scenario: Scenario, who: str, when: str, sentence: str) -> Failure:
    names = [scenario.uav_name(u) for u in range(scenario.uavs)]
    numbered = _NUMBERED.fullmatch(who)
    if who in names:
        uav = names.index(who)
    elif numbered and int(numbered[1]) < scenario.uavs:
        uav = int(numbered[1])
    elif numbered:
        raise InputError(
            f"--what-if {short(sentence)}: there is no {who}: {scenario.uavs} UAVs are numbered from 0 to "
            f"{scenario.uavs - 1}"
        )
    elif who.lower() == ONE.lower():
        raise InputError(f"--what-if {short(sentence)}: say which one to fly without, such as {names[-1]}")
    else:
        raise InputError(f"--what-if {short(sentence)}: {unknown('UAV', who, names)}")
    slot = _slot(scenario, when)
    if slot is None:
        raise InputError(
            f"--what-if {short(sentence)}: '{when}' is no time: half time, slot 100 or 30 min would be one"
        )
    if not 1 <= slot <= scenario.slots:
        raise InputError(f"--what-if {short(sentence)}: is slot {slot:,}, and the mission has {scenario.slots:,} slots")
    return Failure(uav=uav, slot=slot)


def _slot(scenario: Scenario, when: str) -> int | None:
    if _HALF.fullmatch(when):
        return max(scenario.slots // 2, 1)
    if numbered := _SLOT.fullmatch(when):
        return int(numbered[1])
    value = in_own_units({"time_s": when})["time_s"]
    if isinstance(value, MisreadText) or not isinstance(value, int | float):
        return None
    return max(round(value / scenario.slot_length_s), 1)
