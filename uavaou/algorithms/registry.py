"""The algorithms by name: those of this package and those of others, registered the same way.

An entry is a configuration class, the function that builds the learner, and the file of published settings.
Other algorithms come from an installed package (entry points of the group ``uavaou.algorithms``), or from a
file or module that the user names. Reading a run's folder never imports code.

Importing this module does not import torch.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uavaou.algorithms.config import (
    AlgorithmConfig,
    IppoConfig,
    JointQConfig,
    LearnerConfig,
    MappoConfig,
    QmixConfig,
    VdnConfig,
)
from uavaou.errors import InputError, unknown
from uavaou.fields import validated
from uavaou.zoo import read_yaml_mapping, zoo_folder

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

    from uavaou.envs.vec_env import MissionVecEnv

Builder = Callable[[Any, Any, int, str], "BaseAlgorithm"]  # (config, env, seed, device)
ENTRY_POINTS = "uavaou.algorithms"


@dataclass(frozen=True)
class Algorithm:
    """An algorithm as it is registered."""

    config: type[AlgorithmConfig]
    build: Builder
    defaults: Path | None  # YAML; None: the configuration class has a default for every field
    space: Mapping[str, Any] | None = None  # what a search varies; None: what is shipped for the name, if there is any


_ALGORITHMS: dict[str, Algorithm] = {}
_LEARNERS = {"mappo-paper": "mappo", "mappo-family": "mappo"}  # of other published settings
_PLUGINS: set[Path] = set()  # files already loaded


def register_algorithm(
    name: str,
    config: type[AlgorithmConfig],
    build: Builder,
    defaults: Path | None = None,
    space: Mapping[str, Any] | None = None,
) -> None:
    """Make an algorithm known by name to training, evaluation and every command.

    Args:
        name: lower-case letters, digits, ``-`` and ``_``.
        config: its settings; a subclass of :class:`~uavaou.algorithms.config.AlgorithmConfig`.
        build: ``build(config, env, seed, device)`` returns an SB3 algorithm on ``env``, which is what
            :func:`uavaou.flatten` returns.
        defaults: a YAML file with the published settings; None if every field of ``config`` has a default.
        space: what ``uavaou tune`` varies: fields and their ranges, as in a file for ``--space``.

    Raises:
        InputError: the name is taken or misspelt, or ``config`` is not such a class.

    Examples:
        >>> from stable_baselines3 import PPO
        >>> from uavaou import AlgorithmConfig, LocalRows, register_algorithm
        >>> class OwnConfig(AlgorithmConfig):
        ...     slots: int = 50_000
        ...     missions: int = 16
        ...     evaluate_every_slots: int = 10_000
        >>> def build(config, env, seed, device):
        ...     return PPO("MlpPolicy", LocalRows(env), seed=seed, device=device)
        >>> register_algorithm("own-ppo", OwnConfig, build)
    """
    if not re.fullmatch(r"[a-z0-9][a-z0-9_-]*", name):
        raise InputError(f"algorithm name {name!r}: expected lower-case letters, digits, '-' and '_'")
    if name in _ALGORITHMS:
        raise InputError(f"algorithm '{name}' is registered already: choose another name")
    if not (isinstance(config, type) and issubclass(config, AlgorithmConfig)):
        raise InputError(f"algorithm '{name}': config = {config!r}: expected a subclass of uavaou.AlgorithmConfig")
    _ALGORITHMS[name] = Algorithm(config, build, defaults, space)


def algorithm_names() -> list[str]:
    """The registered names, and those that installed packages offer."""
    return list(dict.fromkeys([*_ALGORITHMS, *sorted(entry_points(group=ENTRY_POINTS).names)]))


def registered_fields() -> list[str]:
    """The fields of all registered configurations, each once."""
    return list(dict.fromkeys(field for entry in _ALGORITHMS.values() for field in entry.config.model_fields))


def find_algorithm(name: str) -> Algorithm:
    """Return the algorithm of a name; imports the installed package that offers it.

    Raises:
        InputError: no algorithm has that name.
    """
    if name not in _ALGORITHMS:
        for entry in entry_points(group=ENTRY_POINTS, name=name):
            entry.load()  # its module registers what it offers
            if name not in _ALGORITHMS:
                raise InputError(f"algorithm '{name}': {entry.value} should register it, and does not")
    if name not in _ALGORITHMS:
        raise unknown("algorithm", name, algorithm_names())
    return _ALGORITHMS[name]


def load_plugin(place: str) -> None:
    """Import a Python file or a module that registers algorithms.

    Raises:
        InputError: no such file or module exists, or the file registers nothing.
    """
    if place.endswith(".py"):
        _load_file(Path(place))
        return
    try:
        import_module(place)
    except (ModuleNotFoundError, ValueError, TypeError) as error:
        if isinstance(error, ModuleNotFoundError) and not f"{place}.".startswith(f"{error.name}."):
            raise  # the module exists, but something that it imports does not
        raise InputError(f"plugin '{place}': no such module (a file's name ends in .py)") from None


def _load_file(path: Path) -> None:
    if not path.is_file():
        raise InputError(f"plugin '{path}': no such file")
    path = path.resolve()
    if path in _PLUGINS:
        return
    before = set(_ALGORITHMS)
    spec = spec_from_file_location(f"uavaou_plugin_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # the file can import its neighbours, which shadow nothing
    spec.loader.exec_module(module)
    if set(_ALGORITHMS) == before:
        raise InputError(f"plugin '{path}' registers no algorithm: it must call uavaou.register_algorithm")
    _PLUGINS.add(path)


def load_config(algorithm: str, overrides: dict[str, Any] | None = None) -> AlgorithmConfig:
    """Load an algorithm's published configuration, with some fields changed.

    Where ``overrides`` choose another network than the published one, a file such as ``vdn-set.yaml`` replaces some of
    the fields, or ``mappo-paper.yaml`` all. Where they change the budget, validations follow it
    (:meth:`AlgorithmConfig.with_enough_validations`).

    Raises:
        InputError: the algorithm or a field is unknown, or a value cannot be used.
    """
    entry = find_algorithm(algorithm)
    published = {} if entry.defaults is None else read_yaml_mapping(entry.defaults)
    overrides = overrides or {}
    usual = published.get("network", "mlp")
    if entry.defaults is not None and overrides.get("network", usual) != usual:
        suffix = "paper" if overrides["network"] == "mlp" else "set"
        path = entry.defaults.with_name(f"{entry.defaults.stem}-{suffix}.yaml")
        of_network = read_yaml_mapping(path) if path.is_file() else {}
        published = of_network if "name" in of_network else published | of_network
    fields = published | {"name": learner_of(algorithm)} | overrides
    config = validated(entry.config, fields, f"algorithm '{algorithm}'")
    return config.with_enough_validations(overrides) if "slots" in overrides else config


def learner_of(name: str) -> str:
    """Return the learner that published settings of this name are of."""
    return _LEARNERS.get(name, name)


def published_as(algorithm: str, network: str = "", for_family: bool = False) -> str:
    """Return the name under which an algorithm's settings are published, for families or with a flat network.

    Those of ``mappo`` are for one map, those of ``mappo-family`` for many; ``mappo-paper`` learns from nothing.
    """
    name = f"{algorithm}-paper" if network == "mlp" else f"{algorithm}-family" if for_family else algorithm
    return name if name in _ALGORITHMS else algorithm


def config_from_dict(fields: dict[str, Any], source: Path) -> AlgorithmConfig:
    """Read the algorithm part of a run's ``config.yaml``.

    Raises:
        InputError: the algorithm is not known here, or a value cannot be used.
    """
    name = fields.get("name")
    # The names that packages offer come last: to find them takes ten times as long as the rest.
    if not isinstance(name, str) or (name not in _ALGORITHMS and name not in algorithm_names()):
        raise InputError(
            f"{source}: algorithm.name = {name!r}: known are {', '.join(algorithm_names())}; "
            "if it is one of your own, name what registers it: uavaou --plugin FILE.py ..."
        )
    return validated(find_algorithm(name).config, fields, f"{source}: algorithm")


def changed_config(fields: dict[str, Any], changes: Mapping[str, Any]) -> AlgorithmConfig:
    """A run's settings, which are sound, with some ``changes``; an error blames these.

    Raises:
        InputError: a value cannot be used.
    """
    source = "--set algorithm"
    try:
        return validated(find_algorithm(fields["name"]).config, {**fields, **changes}, source)
    except InputError as error:
        problem = str(error).removeprefix(f"{source}: ")
        stated = re.split(r"\W", problem)[0] in changes
        raise InputError(f"{source}.{problem}" if stated else f"{source}: {problem}") from None


def make_model(config: AlgorithmConfig, env: MissionVecEnv, seed: int, device: str) -> BaseAlgorithm:
    """Build the learner of a configuration on a flattened environment.

    Raises:
        InputError: its policy cannot act on local observations alone, as a UAV must.
    """
    model, refused = find_algorithm(config.name).build(config, env, seed, device), f"algorithm '{config.name}'"
    if model.get_vec_normalize_env() is not None:
        raise InputError(f"{refused}: checkpoints do not hold what VecNormalize measures: normalise in the policy")
    shape = model.observation_space.shape
    if not hasattr(model.policy, "act") and shape != (env.local_size,):
        raise InputError(
            f"{refused}: its policy reads {shape}, and a UAV sees ({env.local_size},), the local observation: "
            "build it on uavaou.LocalRows(env), or give its policy act(local, uniforms)"
        )
    return model


_OWN: tuple[tuple[str, type[LearnerConfig], str], ...] = (
    ("mappo", MappoConfig, "mappo"),
    ("mappo-paper", MappoConfig, "mappo-paper"),
    ("mappo-family", MappoConfig, "mappo-family"),
    ("ippo", IppoConfig, "ippo"),
    ("vdn", VdnConfig, "vdn"),
    ("qmix", QmixConfig, "qmix"),
    ("iql", JointQConfig, "vdn"),  # another mixer
)
for _name, _config, _published in _OWN:
    register_algorithm(_name, _config, _config.build, zoo_folder("algorithms") / f"{_published}.yaml")
