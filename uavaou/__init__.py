"""uavaou: teams of UAVs that keep IoT data fresh, trained, planned, evaluated and explained.

The public names load on first use, so that ``import uavaou`` is quick and needs no torch. ``train`` trains a policy
into a run folder, ``load_run`` loads the best policy of one, ``evaluate`` measures a policy or a planner, and
``read_study`` reads the results of a study.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uavaou.algorithms.config import AlgorithmConfig as AlgorithmConfig
    from uavaou.algorithms.mappo import IPPO as IPPO
    from uavaou.algorithms.mappo import MAPPO as MAPPO
    from uavaou.algorithms.qlearning import IQL as IQL
    from uavaou.algorithms.qlearning import QMIX as QMIX
    from uavaou.algorithms.qlearning import VDN as VDN
    from uavaou.algorithms.registry import register_algorithm as register_algorithm
    from uavaou.envs import uavaou_v0 as uavaou_v0
    from uavaou.envs.flatten import flatten as flatten
    from uavaou.envs.vec_env import LocalRows as LocalRows
    from uavaou.errors import InputError as InputError
    from uavaou.experiments.results import read_study as read_study
    from uavaou.family import Family as Family
    from uavaou.runs.comparison import evaluate as evaluate
    from uavaou.runs.folder import RunConfig as RunConfig
    from uavaou.runs.policy import load_run as load_run
    from uavaou.runs.rehearsal import rehearse as rehearse
    from uavaou.runs.train import train as train
    from uavaou.scenario import Scenario as Scenario
    from uavaou.world import World as World

__version__ = "1.0.0"

_HOMES = {
    "Scenario": "uavaou.scenario",
    "Family": "uavaou.family",
    "World": "uavaou.world",
    "flatten": "uavaou.envs.flatten",
    "MAPPO": "uavaou.algorithms.mappo",
    "IPPO": "uavaou.algorithms.mappo",
    "VDN": "uavaou.algorithms.qlearning",
    "IQL": "uavaou.algorithms.qlearning",
    "QMIX": "uavaou.algorithms.qlearning",
    "AlgorithmConfig": "uavaou.algorithms.config",
    "register_algorithm": "uavaou.algorithms.registry",
    "LocalRows": "uavaou.envs.vec_env",
    "InputError": "uavaou.errors",
    "RunConfig": "uavaou.runs.folder",
    "train": "uavaou.runs.train",
    "load_run": "uavaou.runs.policy",
    "evaluate": "uavaou.runs.comparison",
    "rehearse": "uavaou.runs.rehearsal",
    "read_study": "uavaou.experiments.results",
}
__all__ = [*_HOMES, "uavaou_v0"]


def __getattr__(name: str) -> Any:
    if name == "uavaou_v0":
        return import_module("uavaou.envs.uavaou_v0")
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'uavaou' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
