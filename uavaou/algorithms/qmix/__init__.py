"""QMIX."""

from uavaou.algorithms.common.joint_policy import JointQPolicy
from uavaou.algorithms.qmix.qmix import QMIX

__all__ = ["QMIX", "JointQPolicy"]
