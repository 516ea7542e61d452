"""MAPPO-AoU and its independent counterpart, IPPO."""

from uavaou.algorithms.common.policy import CentralizedValuePolicy
from uavaou.algorithms.mappo.mappo import IPPO, MAPPO

__all__ = ["IPPO", "MAPPO", "CentralizedValuePolicy"]
