"""The exact expected age of fixed routes.

Fading is independent from slot to slot. So with the routes fixed, each collection succeeds independently of all
earlier ones. Let f_i[t] be the probability that no UAV has device i in range in slot t. The expected pending count m
and age sum S (in slots) after slot t obey the recursion of the age ledger,

    m_i[t] = f_i[t] (m_i[t-1] + g_i[t]),    S_i[t] = f_i[t] (S_i[t-1] + m_i[t-1] + g_i[t]),

where g is 1 if an update is generated in slot t. The age still to come after slot t (the cost to go) is linear in
(m, S), and its coefficients obey a recursion backwards in time. Both are stored for every slot. So the age of changed
routes costs only the slots that change.
"""

from typing import NamedTuple

from uavaou.arrays import Floats, Ints


class ExpectedAge(NamedTuple):
    """The routes of a fleet and their expected ages, in slots; row t of each array is slot t, row 0 precedes slot 1."""

    miss: Floats  # (U, C, I) 1 - P(R_iu >= R_min) with UAV u in a cell
    generated: Floats  # (K+1, I) g_i[t]: 1 where t mod k_i = 0
    routes: Ints  # (U, K+1) cell = column * rows + row
    fleet_miss: Floats  # (K+1, I) f_i[t]
    pending: Floats  # (K+1, I) m_i[t]
    age: Floats  # (K+1, I) S_i[t]
    cumulative: Floats  # (K+1,) sum over devices and over slots up to t of S_i
    to_go_per_pending: Floats  # (K+1, I) cost to go after slot t for each pending update
    to_go_per_age: Floats  # (K+1, I) cost to go after slot t for each slot of age
    to_go_constant: Floats  # (K+1,) cost to go after slot t from updates generated later

    @property
    def total_age(self) -> float:
        """The sum over slots and devices of E[sum_n A_i^n], in slots squared: K times the mean AoU, over tau."""
        return float(self.cumulative[-1])
