"""The age of updates, eq. (1) of the paper, as a ledger that needs no list of updates.

All pending updates of a device age together and are delivered together. So two integers describe a device: the number
of pending updates, and the sum of their ages in slots. Integers keep the ledger exact.
"""

from typing import Any

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

    def advance(self, generated: Bools, collected: Bools) -> Bools:
        """Advance by one slot: generate, age, deliver.

        Args:
            generated: whether the device generates an update in this slot, (N, I) or (1, I).
            collected: whether some UAV collects the device in this slot, (N, I).

        Returns:
            Whether a transfer carried at least one update, i.e. was a *communication*, (N, I).
        """
        communications = np.empty(collected.shape, dtype=np.bool_)  # (N, I)
        _advance(generated, collected, self.pending, self.age_slots, communications)
        return communications


def age_by_estimate(slot: Any, last: Any, period: Any) -> Any:
    """Return the age sum in slots at the end of ``slot`` of a device that was last collected in slot ``last``.

    Update n is generated in slot n k, at whose end it has an age of one slot (eq. 1); update 0 begins with none.

    Args:
        slot: t.
        last: slot of the last collection, 0 for never; a number, or an array.
        period: k, slots; of the same kind.
    """
    newest, delivered = slot // period, last // period
    generated = newest * (newest + 1) - delivered * (delivered + 1)
    return (newest - delivered) * (slot + 1) - period * generated // 2 + slot * (last == 0)


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
