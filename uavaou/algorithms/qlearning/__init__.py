"""Q-learning of a team from a joint replay: VDN, QMIX, and IQL, the ablation without mixing."""

from uavaou.algorithms.qlearning.learner import IQL, QMIX, VDN
from uavaou.algorithms.qlearning.policy import JointQPolicy

__all__ = ["IQL", "QMIX", "VDN", "JointQPolicy"]
