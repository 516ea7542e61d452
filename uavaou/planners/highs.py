"""Linear and mixed-integer programs for the solver HiGHS, through its own Python package."""

from collections.abc import Callable

import highspy
import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csc_array

from uavaou.arrays import Floats, Ints

_LOOK_S = 0.2  # between two looks at the bounds and the keyboard


class LinearProgram:
    """The program min c x subject to 0 <= x <= upper and low <= A x <= high, built block by block."""

    def __init__(self) -> None:
        self._variables = self._constraints = 0
        self._costs: list[Floats] = []
        self._upper: list[Floats] = []
        self._low: list[Floats] = []
        self._high: list[Floats] = []
        self._terms: list[tuple[Ints, Ints, Floats]] = []  # rows, columns and values of A

    def add_variables(self, upper: Floats, costs: Floats | None = None) -> Ints:
        """Add a variable for each upper limit, of any shape; return their columns in that shape. Costs default to 0."""
        columns = self._variables + np.arange(upper.size).reshape(upper.shape)
        self._variables += upper.size
        self._upper.append(upper.ravel())
        self._costs.append(np.zeros(upper.size) if costs is None else costs.ravel())
        return columns

    def add_constraints(self, number: int, low: ArrayLike, high: ArrayLike) -> Ints:
        """Add ``number`` constraints and return their rows; each limit is a number or an array of them."""
        rows = self._constraints + np.arange(number)
        self._constraints += number
        self._low.append(np.broadcast_to(np.asarray(low, dtype=np.float64), number))
        self._high.append(np.broadcast_to(np.asarray(high, dtype=np.float64), number))
        return rows

    def add_terms(self, rows: Ints, columns: Ints, values: Floats | float) -> None:
        """Add ``values`` to the coefficients of A at rows and columns; the three broadcast."""
        entries = np.broadcast_arrays(rows, columns, values)
        self._terms.append((entries[0].ravel(), entries[1].ravel(), entries[2].ravel().astype(np.float64)))

    def solver(self) -> highspy.Highs:
        """Return a solver that holds the program; it is silent and uses one core."""
        rows, columns, values = (np.concatenate(part) for part in zip(*self._terms, strict=True))
        matrix = csc_array((values, (rows, columns)), shape=(self._constraints, self._variables))
        matrix.eliminate_zeros()
        program = highspy.HighsLp()
        program.num_row_, program.num_col_ = matrix.shape
        program.col_cost_, program.col_upper_ = np.concatenate(self._costs), np.concatenate(self._upper)
        program.col_lower_ = np.zeros(self._variables)
        program.row_lower_, program.row_upper_ = np.concatenate(self._low), np.concatenate(self._high)
        program.a_matrix_.format_ = highspy.MatrixFormat.kColwise
        program.a_matrix_.start_, program.a_matrix_.index_ = matrix.indptr, matrix.indices
        program.a_matrix_.value_ = matrix.data
        solver = highspy.Highs()  # type: ignore[no-untyped-call]
        solver.silent()
        solver.setOptionValue("threads", 1)
        solver.passModel(program)
        return solver


def run_interruptibly(solver: highspy.Highs, on_progress: Callable[[float, float], None]) -> bool:
    """Run a mixed-integer solver to its end; Ctrl-C stops it at once. Return whether it was stopped.

    Args:
        solver: holds the program.
        on_progress: receives the best objective and its bound now and then; each is infinite if there is none yet. A
            KeyboardInterrupt that it raises stops the solver too.
    """
    seen = [np.inf, -np.inf]

    def look(event: highspy.HighsCallbackEvent) -> None:
        seen[:] = [event.data_out.mip_primal_bound, event.data_out.mip_dual_bound]

    solver.HandleUserInterrupt = True
    solver.cbMipInterrupt += look
    solver.startSolve()  # in a thread, so that this thread receives Ctrl-C
    try:
        while not solver.wait(_LOOK_S)[0]:
            on_progress(*seen)
    except KeyboardInterrupt:
        solver.cancelSolve()  # type: ignore[no-untyped-call]
        solver.wait()  # Thread.join cannot be used: after an interrupted join it no longer knows the thread
        return True
    return False
