"""QMIX (Rashid et al. 2018, arXiv 1803.11485)."""

from __future__ import annotations

from typing import ClassVar

from uavaou.algorithms.qlearning.learner import JointQLearning


class QMIX(JointQLearning):
    """Q_tot is monotone in the UAVs' utilities, by a mixing network whose weights the global state gives.

    Arguments: :class:`JointQLearning`; ``policy_kwargs`` takes ``mixer_width`` and ``hypernet_width``.
    """

    mixer: ClassVar[str] = "monotonic"
