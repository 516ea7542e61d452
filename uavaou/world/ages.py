"""The age of updates, eq. (1) of the paper, as a ledger that needs no list of updates.

All pending updates of a device age together and are delivered together. So two integers describe a device: the number
of pending updates, and the sum of their ages in slots. Integers keep the ledger exact.
"""

import numpy as np

from uavaou.arrays import Bools, Ints
from uavaou.world.compiled import compiled


class AgeLedger:
    """Pending updates and age sums of I devices in N missions.

    Before slot 1 every device holds one update (n = 0, generated in slot 0) of age 0.
    """

    def __init__(self, missions: int, devices: int) -> None:
        self.pending = np.ones((missions, devices), dtype=np.int64)  # (N, I)
        self.age_slots = np.zeros((missions, devices), dtype=np.int64)  # (N, I)

    def advance(self, slot: int, update_period: Ints, collected: Bools) -> Bools:
        """Advance by one slot: generate, age, deliver.

        Args:
            slot: t, counted from 1.
            update_period: k_i in slots, (N, I) or (1, I).
            collected: whether some UAV collects the device in this slot, (N, I).

        Returns:
            Whether a transfer carried at least one update, i.e. was a *communication*, (N, I).
        """
        communications = np.empty(collected.shape, dtype=np.bool_)  # (N, I)
        _advance(slot % update_period == 0, collected, self.pending, self.age_slots, communications)
        return communications


@compiled
def _advance(generated: Bools, collected: Bools, pending: Ints, age_slots: Ints, communications: Bools) -> None:
    missions, devices = pending.shape
    for n in range(missions):
        row = n if len(generated) > 1 else 0
        for i in range(devices):
            waiting = pending[n, i] + generated[row, i]
            communications[n, i] = collected[n, i] and waiting > 0
            left = 0 if collected[n, i] else 1
            age_slots[n, i] = left * (age_slots[n, i] + waiting)
            pending[n, i] = left * waiting
