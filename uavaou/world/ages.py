"""The age of updates, eq. (1) of the paper, as a ledger that needs no list of updates.

All pending updates of a device age together and are delivered together, so two whole numbers a device
say everything: how many updates are pending, and the sum of their ages in slots. Whole slots keep the
ledger exact; seconds appear only where somebody reads it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class AgeLedger:
    """Pending updates and age sums of I devices in N missions.

    Before slot 1 every device holds one update (n = 0, generated at slot 0) of age 0.
    """

    def __init__(self, missions: int, devices: int) -> None:
        self.pending: NDArray[np.int64] = np.ones((missions, devices), dtype=np.int64)  # (N, I)
        self.age_slots: NDArray[np.int64] = np.zeros((missions, devices), dtype=np.int64)  # (N, I)

    def reset(self) -> None:
        """Go back to the moment before slot 1."""
        self.pending.fill(1)
        self.age_slots.fill(0)

    def advance(self, slot: int, update_period: NDArray[np.int64], collected: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Play one slot: generate, age, deliver.

        Args:
            slot: t, from 1 on.
            update_period: k_i in slots, (N, I) or (1, I).
            collected: whether some UAV collects the device in this slot, (N, I).

        Returns:
            Where a transfer carried at least one update, i.e. was a *communication*, (N, I).
        """
        self.pending += slot % update_period == 0
        communications: NDArray[np.bool_] = collected & (self.pending > 0)
        self.age_slots += self.pending
        kept = ~collected  # (N, I)
        self.pending *= kept
        self.age_slots *= kept
        return communications
