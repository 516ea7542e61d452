"""MAPPO-AoU and its independent counterpart, IPPO."""

from uavaou.algorithms.mappo.mappo import IPPO, MAPPO
from uavaou.algorithms.mappo.policy import CentralizedValuePolicy

__all__ = ["IPPO", "MAPPO", "CentralizedValuePolicy"]
