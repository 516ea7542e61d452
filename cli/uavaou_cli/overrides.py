"""``--set KEY=VALUE``: dotted keys of the scenario and of the algorithm's configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from uavaou.errors import InputError, all_faults, nearest
from uavaou_cli.options import given_path

if TYPE_CHECKING:
    from uavaou.algorithms.config import AlgorithmConfig
    from uavaou.scenario import Scenario


@dataclass(frozen=True)
class Overrides:
    """The values of ``--set``: dotted keys without their prefix -> text as typed."""

    scenario: dict[str, str]
    algorithm: dict[str, str]

    def of_scenario(self, base: Scenario) -> Scenario:
        """The scenario with its overrides applied.

        Raises:
            InputError: a key is unknown or a value cannot be used.
        """
        if not self.scenario:
            return base
        fields = dict.fromkeys((*type(base).model_fields, "devices_csv", "radio")) | base.to_dict()
        changes = _changes("scenario", self.scenario, fields)
        faults: list[InputError] = []
        with_line: Callable[[str], str] = str
        if "devices_csv" in changes:
            from uavaou.devices_csv import read_devices

            table = given_path("--set scenario.devices_csv", str(changes.pop("devices_csv")))
            with_line = read_devices(table, changes, changes.get("devices"), faults)
        try:
            changed = base.replace(**changes)
        except InputError as error:
            faults += error.reworded(with_line).faults
        if faults:
            raise all_faults(f"scenario '{base.name}'", faults)
        return changed

    def of_algorithm(self, name: str, **usual: Any) -> AlgorithmConfig:
        """The published configuration of an algorithm with its overrides applied.

        Args:
            name: of the algorithm.
            usual: fields with a value of their own, where the algorithm has them and no override changes them.

        Raises:
            InputError: the algorithm or a key is unknown, or a value cannot be used.
        """
        from uavaou.algorithms.registry import load_config

        published = load_config(name)
        usual = {field: value for field, value in usual.items() if field in type(published).model_fields}
        return load_config(name, usual | self.changes_of(published))

    def changes_of(self, settings: AlgorithmConfig) -> dict[str, Any]:
        """The fields of an algorithm's ``settings`` that the overrides change, with their new values.

        Raises:
            InputError: a key is unknown.
        """
        if "name" in self.algorithm:
            raise InputError("--set algorithm.name: choose the algorithm with --algorithm")
        return _changes("algorithm", self.algorithm, settings.model_dump(mode="json"))

    def only_of_scenario(self, why: str) -> None:
        """Refuse changes of an algorithm, saying ``why``."""
        for key in self.algorithm:
            raise InputError(f"--set algorithm.{key}: {why}; only scenario.* can be set here")


def parse_overrides(items: Sequence[str]) -> Overrides:
    """Sort ``KEY=VALUE`` items by their prefix.

    Raises:
        InputError: an item is no ``KEY=VALUE``, has no known prefix, or repeats or overlaps another.
    """
    overrides = Overrides({}, {})
    for item in items:
        key, equals, value = item.partition("=")
        if not equals or not key or not value.strip():
            raise InputError(f"--set {item}: expected KEY=VALUE, such as scenario.layout_seed=7")
        part, _, rest = key.partition(".")
        if part not in ("scenario", "algorithm") or not rest:
            raise InputError(f"--set {item}: keys are scenario.FIELD or algorithm.FIELD{_nearest_key(key)}")
        given = getattr(overrides, part)
        for other in given:
            if other == rest:
                raise InputError(f"--set {key}: given twice")
            if other.startswith(f"{rest}.") or rest.startswith(f"{other}."):
                raise InputError(f"--set {part}.{other} and --set {key}: give one of them")
        given[rest] = value
    return overrides


def _nearest_key(key: str) -> str:
    from uavaou.algorithms.registry import registered_fields
    from uavaou.scenario import Scenario

    known = [f"scenario.{name}" for name in Scenario.model_fields]
    known += [f"algorithm.{name}" for name in registered_fields()]
    same = [f"'{name}'" for name in known if name.endswith(f".{key}")]
    return f"; did you mean {' or '.join(same)}?" if same else nearest(key, known)


def _changes(part: str, given: Mapping[str, str], fields: Mapping[str, Any]) -> dict[str, Any]:
    """The new values of whole fields, from dotted keys that reach into ``fields``, such as ``bandwidth_hz.low``."""
    from uavaou.fields import short
    from uavaou.plain_yaml import parse_yaml

    changed = deepcopy(dict(fields))
    for key, text in given.items():
        value: Any = changed
        where = part
        for name in key.split("."):
            if not isinstance(value, dict):
                raise InputError(f"--set {where}.{name}: {where} = {value!r} has no parts; set it as a whole")
            if name not in value:
                hint = nearest(name, value) or f" (known: {', '.join(value)})"
                raise InputError(f"--set {where}.{name}: {where} has no '{name}'{hint}")
            inside, value, where = value, value[name], f"{where}.{name}"
        inside[name] = parse_yaml(text, f"--set {where} = {short(text)}")
    return {field: changed[field] for field in (key.split(".")[0] for key in given)}
