"""The age ledger against eq. (1) of the paper, played literally with one age for each update."""

from collections.abc import Sequence

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from uavaou import World
from uavaou.world.ages import AgeLedger


class LiteralAges:
    """Eq. (1) for one device: a list of (generated at, age) for every update ever generated.

    A_i^n[t] = (A_i^n[t-1] + tau) (1 - alpha), the update's age counting from the slot n k_i on; a delivered
    update keeps age 0. In whole slots.
    """

    def __init__(self, period: int) -> None:
        self.period = period
        self.ages = [0]  # A_i^n[t] for n = 0, 1, ...; A_i^0[0] = 0
        self.delivered = [False]

    def advance(self, slot: int, collected: bool) -> int:
        """Play slot t; returns how many updates a transfer carried."""
        if slot % self.period == 0:  # update n = t / k_i, whose age before it existed counts as 0
            assert len(self.ages) == slot // self.period
            self.ages.append(0)
            self.delivered.append(False)
        carried = 0
        for n in range(len(self.ages)):
            if self.delivered[n]:
                continue
            self.ages[n] += 1
            if collected:
                self.ages[n] = 0
                self.delivered[n] = True
                carried += 1
        return carried

    @property
    def pending(self) -> int:
        """Updates not delivered yet."""
        return self.delivered.count(False)


def play(periods: Sequence[int], collections: np.ndarray) -> None:
    """Play both, slot by slot; collections are (K, I) booleans."""
    ledger = AgeLedger(1, len(periods))
    literal = [LiteralAges(k) for k in periods]
    for slot, collected in enumerate(collections, start=1):
        communications = ledger.advance(slot % np.array([periods]) == 0, collected[None])
        carried = [device.advance(slot, bool(c)) for device, c in zip(literal, collected, strict=True)]
        assert communications[0].tolist() == [c > 0 for c in carried]
        assert ledger.pending[0].tolist() == [device.pending for device in literal]
        assert ledger.age_slots[0].tolist() == [sum(device.ages) for device in literal]


@given(st.data())
def test_ledger_equals_the_recursion(data: st.DataObject) -> None:
    periods = data.draw(st.lists(st.integers(1, 9), min_size=1, max_size=5))
    slots = data.draw(st.integers(1, 40))
    rng = np.random.default_rng(data.draw(st.integers(0, 10**6)))
    play(periods, rng.random((slots, len(periods))) < data.draw(st.sampled_from([0.0, 0.1, 0.5, 1.0])))


def test_ledger_equals_the_recursion_over_a_long_mission() -> None:
    rng = np.random.default_rng(3)
    play([1, 2, 3, 4, 5], rng.random((500, 5)) < 0.02)


def test_reset_returns_to_the_moment_before_slot_1() -> None:
    world = World("tiny", missions=2)
    world.step(np.zeros((2, 2), dtype=int))
    world.reset()
    assert (world.pending == 1).all()
    assert (world.age_sum == 0).all()
