"""VDN (Sunehag et al. 2018, arXiv 1706.05296), and IQL, the same without mixing."""

from __future__ import annotations

from typing import ClassVar

from uavaou.algorithms.qlearning.learner import JointQLearning


class VDN(JointQLearning):
    """Value decomposition: Q_tot is the sum of the UAVs' utilities. Arguments: :class:`JointQLearning`."""

    mixer: ClassVar[str] = "sum"


class IQL(JointQLearning):
    """Independent Q-learning: every UAV learns the team's return by itself (Tan 1993)."""

    mixer: ClassVar[str] = "none"
