"""``--set KEY=VALUE``: dotted keys of the scenario and of the algorithm's configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from uavaou.errors import InputError, nearest

if TYPE_CHECKING:
    from uavaou.algorithms.config import AlgorithmConfig
    from uavaou.scenario import Scenario

PARTS = ("scenario", "algorithm")


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
        known = list(type(base).model_fields)
        return base.replace(**changes("scenario", self.scenario, base.to_dict(), known)) if self.scenario else base

    def of_algorithm(self, name: str) -> AlgorithmConfig:
        """The published configuration of an algorithm with its overrides applied.

        Raises:
            InputError: the algorithm or a key is unknown, or a value cannot be used.
        """
        from uavaou.algorithms.registry import load_config

        published = load_config(name).model_dump(mode="json")
        if "name" in self.algorithm:
            raise InputError("--set algorithm.name: choose the algorithm with --algorithm")
        return load_config(name, changes("algorithm", self.algorithm, published, list(published)))

    def only_of_scenario(self, why: str) -> None:
        """Refuse changes of an algorithm.

        Raises:
            InputError: saying ``why``.
        """
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
        if part not in PARTS or not rest:
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


def changes(prefix: str, given: Mapping[str, str], fields: Mapping[str, Any], known: Sequence[str]) -> dict[str, Any]:
    """Turn dotted keys into new values of whole fields.

    Args:
        prefix: for messages.
        given: dotted key -> value as typed.
        fields: the present values, into which ``bandwidth_hz.low`` and its like reach.
        known: the names of all fields.

    Raises:
        InputError: a key is unknown, or reaches into a value that has no parts.
    """
    changed: dict[str, Any] = {}
    for key, text in given.items():
        field, *path = key.split(".")
        if field not in known:
            raise _unknown_key(prefix, field, known)
        if not path:
            changed[field] = parse_value(text)
            continue
        changed.setdefault(field, _copied(fields.get(field)))
        _set_inside(changed[field], path, parse_value(text), f"{prefix}.{field}")
    return changed


def _unknown_key(where: str, name: str, known: Sequence[str]) -> InputError:
    hint = nearest(name, known) or f" (known: {', '.join(known)})"
    return InputError(f"--set {where}.{name}: {where} has no '{name}'{hint}")


def _copied(value: Any) -> Any:
    return {key: _copied(inner) for key, inner in value.items()} if isinstance(value, dict) else value


def _set_inside(value: Any, path: Sequence[str], new: Any, where: str) -> None:
    name = path[0]
    if not isinstance(value, dict):
        raise InputError(f"--set {where}.{name}: {where} = {value!r} has no parts; set it as a whole")
    if name not in value:
        raise _unknown_key(where, name, list(value))
    if len(path) == 1:
        value[name] = new
    else:
        _set_inside(value[name], path[1:], new, f"{where}.{name}")


def parse_value(text: str) -> Any:
    """Read a value as a person means it: a number as Python reads it (``1e-4``), else YAML, else the text itself."""
    import yaml

    number = _number(text)
    if number is not None:
        return number
    try:
        return _with_numbers(yaml.safe_load(text))
    except (yaml.YAMLError, ValueError, RecursionError):
        return text


def _number(text: str) -> int | float | None:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return None


def _with_numbers(value: Any) -> Any:
    """YAML reads ``1e-4`` as text, inside lists and mappings too."""
    if isinstance(value, dict):
        return {key: _with_numbers(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_with_numbers(inner) for inner in value]
    number = _number(value) if isinstance(value, str) else None
    return value if number is None else number
