"""The names of folders and files: what differs from a preset and from the published settings, short enough to read."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from uavaou.algorithms.config import AlgorithmConfig
from uavaou.algorithms.registry import load_config, published_as
from uavaou.family import Family
from uavaou.plain_yaml import to_yaml
from uavaou.radio import PAPER_CHANNEL
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.released import released_names
from uavaou.runs.start import OF_THE_WEIGHTS, Start
from uavaou.scenario import Scenario
from uavaou.zoo import zoo_names, zoo_path

_READABLE = 40  # characters: a name with more changes than that has a digest of them
_LONGEST = 120


def config_folder(out: Path, config: RunConfig) -> RunFolder:
    """The folder that ``uavaou train`` gives a run: named by what differs from the preset and the published settings.

    Two different runs do not share one.

    Args:
        out: the folder of all results.
        config: of the run.

    Raises:
        InputError: the algorithm is not registered.
    """
    return RunFolder(out / map_folder(config) / policy_name(config) / f"seed-{config.seed}")


def policy_name(config: RunConfig, without: Collection[str] = ()) -> str:
    """What a run's policy is called: ``mappo+slots=200000``, ``mappo+3f9a1c`` of many changes, ``mappo-from-any-map``.

    Args:
        config: of the run.
        without: settings that do not make another policy.

    Raises:
        InputError: the algorithm is not registered.
    """
    name, changed = _named(config)
    name += f"-from-{_beginning(config.start)}" if config.start else ""
    return _folder_name(name, {field: value for field, value in changed.items() if field not in without})


def map_folder(config: RunConfig) -> str:
    """The name of the folder of the scenario or the family that a run was trained on."""
    return family_folder(config.family) if config.family else scenario_folder(config.scenario)


def changes(config: RunConfig) -> dict[str, str]:
    """What a run's settings change in the published ones, field by field, as after ``--set``.

    Raises:
        InputError: the algorithm is not registered.
    """
    return _named(config)[1]


def _named(config: RunConfig) -> tuple[str, dict[str, str]]:
    """The name of the published settings that a run started from, and what it changes in them."""
    name, published = published_settings(config.algorithm, config.family is not None)
    kept = OF_THE_WEIGHTS if config.start else frozenset()
    settings = config.algorithm.model_dump(mode="json")
    return name, _differences(published, {field: value for field, value in settings.items() if field not in kept})


@cache
def _beginning(digest: str) -> str:
    """The released policy whose weights have the digest, or the first digits of that."""
    return next((name for name in released_names() if Start.at(name).digest == digest), digest[:6])


def family_folder(family: Family) -> str:
    """The name of the folder of a family's runs, such as ``family-any``; one of your own is told apart by content."""
    shipped = family.name in zoo_names("families") and Family.load(zoo_path("families", family.name)) == family
    return _folder_name(f"family-{family.name}" + ("" if shipped else _content_digest(family.to_dict())), {})


def _content_digest(content: Mapping[str, Any]) -> str:
    return f"~{_digest(to_yaml(content), 8)}"


def scenario_folder(scenario: Scenario, overrides: Mapping[str, str] | None = None) -> str:
    """The name of the folder of a scenario's results, such as ``paper+layout_seed=1``.

    Args:
        scenario: one read from a file is told apart by its content.
        overrides: fields that ``scenario`` does not have yet, as given to ``--set``; None: what differs from the preset
            of its name.
    """
    base = scenario.name
    preset = Scenario.load(zoo_path("scenarios", base)) if base in zoo_names("scenarios") else None
    if overrides is None:
        overrides = _differences(preset.to_dict(), scenario.to_dict()) if preset else {}
    elif preset is not None and preset != scenario:
        preset = None
    return _folder_name(base + ("" if preset else _content_digest(scenario.to_dict())), overrides)


def uavaou_with(plugins: Sequence[str]) -> list[str]:
    """The first words of every command that needs these plugins."""
    return ["uavaou", *(word for place in plugins for word in ("--plugin", place))]


def train_command(
    source: str, scenario: Scenario, algorithm: AlgorithmConfig, plugins: Sequence[str] = ()
) -> list[str]:
    """The words of the ``uavaou train`` command that trains with these settings.

    Args:
        source: the preset or file that the command starts from.
        scenario: that is trained on; what differs from ``source`` is set.
        algorithm: its settings; what differs from the published ones is set.
        plugins: what registers the algorithm, where it is not this package's.

    Raises:
        InputError: ``source`` cannot be read, or the algorithm is not registered.
    """
    command = [*uavaou_with(plugins), "train"]
    name, published = published_settings(algorithm)
    command += ["--scenario", source, "--algorithm", name]
    changes = {
        "scenario": _differences(*(PAPER_CHANNEL | one.to_dict() for one in (Scenario.load(source), scenario))),
        "algorithm": _differences(published, algorithm.model_dump(mode="json")),
    }
    for part, fields in changes.items():
        for name, value in fields.items():
            if name not in ("name", "description"):
                command += ["--set", f"{part}.{name}={value}"]
    return command


def published_settings(algorithm: AlgorithmConfig, for_family: bool = False) -> tuple[str, dict[str, Any]]:
    """The published settings that these start from, and their name: with their network, or for families.

    Validations follow the budget (:func:`load_config`): they differ only where they were set.
    """
    name = published_as(algorithm.name, network := getattr(algorithm, "network", ""), for_family)
    fields = load_config(name).model_dump(mode="json")
    chosen = {"network": network} if network != fields.get("network", "") else {}
    if chosen:
        fields = load_config(name, chosen).model_dump(mode="json") | {"network": None}
    follows = load_config(name, chosen | {"slots": algorithm.slots})
    alike = algorithm.evaluate_every_slots == follows.evaluate_every_slots
    names = ["evaluate_every_slots", "evaluation_missions"] if alike else []
    return name, fields | {field: getattr(follows, field) for field in names}


def _differences(base: Mapping[str, Any], fields: Mapping[str, Any]) -> dict[str, str]:
    """The fields that differ from ``base``, as one would type them after ``--set``."""
    changed = {name: value for name, value in fields.items() if name not in base or base[name] != value}
    return {
        name: value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))
        for name, value in changed.items()
    }


def _folder_name(base: str, overrides: Mapping[str, str]) -> str:
    base = quote(base, safe="~")
    name = name_with(base, overrides)
    return name if len(name) < _READABLE or not overrides else f"{base}+{_digest(json.dumps(overrides), 6)}"


def _digest(text: str, digits: int) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:digits]


def name_with(base: str, changes: Mapping[str, str]) -> str:
    """A name for files, with the changed fields and their values, such as ``paper+layout_seed=1,uavs=2``."""
    parts = [f"{key}={quote(value, safe='.-_')}" for key, value in sorted(changes.items())]
    name = f"{base}+{','.join(parts)}" if parts else base
    return name if len(name) <= _LONGEST else f"{name[:_LONGEST]}~{_digest(name, 12)}"  # file systems end at 255 bytes


def flight_folder(policies: Sequence[str]) -> str:
    """The name of the folder of what these policies flew, given by planner, released policy or path of a run."""
    parts = ["-".join(Path(name).relative_to(Path(name).anchor).parts) for name in policies]
    return name_with(quote(",".join(parts), safe="+=,.-_~%"), {})
