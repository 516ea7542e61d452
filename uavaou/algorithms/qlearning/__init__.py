"""Q-learning of a team from a joint replay: VDN, QMIX, and IQL, the ablation without mixing."""

from uavaou.algorithms.qlearning.policy import JointQPolicy
from uavaou.algorithms.qlearning.qmix import QMIX
from uavaou.algorithms.qlearning.vdn import IQL, VDN

__all__ = ["IQL", "QMIX", "VDN", "JointQPolicy"]
