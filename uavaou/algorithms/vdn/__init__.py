"""VDN and its ablation without mixing, IQL."""

from uavaou.algorithms.common.joint_policy import JointQPolicy
from uavaou.algorithms.vdn.vdn import IQL, VDN

__all__ = ["IQL", "VDN", "JointQPolicy"]
