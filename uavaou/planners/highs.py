"""HiGHS, the solver of linear and mixed-integer programs, through its own Python package."""

from __future__ import annotations

from collections.abc import Callable

import highspy
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

Floats = NDArray[np.float64]


def passed(costs: Floats, upper: Floats, matrix: csc_array, low: Floats, high: Floats) -> highspy.Highs:
    """A solver that holds: minimise costs x, 0 <= x <= upper, low <= matrix x <= high; silent, on one core."""
    program = highspy.HighsLp()
    program.num_row_, program.num_col_ = matrix.shape
    program.col_cost_, program.col_lower_, program.col_upper_ = costs, np.zeros(len(costs)), upper
    program.row_lower_, program.row_upper_ = low, high
    program.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    program.a_matrix_.start_, program.a_matrix_.index_ = matrix.indptr, matrix.indices
    program.a_matrix_.value_ = matrix.data
    solver = highspy.Highs()  # type: ignore[no-untyped-call]
    solver.silent()
    solver.setOptionValue("threads", 1)
    solver.passModel(program)
    return solver


_LOOK_S = 0.2  # between looks at the bounds and the keyboard


def run_interruptibly(solver: highspy.Highs, on_look: Callable[[float, float], None]) -> bool:
    """Run a mixed-integer solver to its end or to Ctrl-C, which stops it within a moment; whether it was stopped.

    Args:
        solver: holds the program.
        on_look: hears now and then of the best objective and of the bound on it; infinite where there is none. A
            KeyboardInterrupt from it stops the solver too.
    """
    seen = [np.inf, -np.inf]

    def look(event: highspy.HighsCallbackEvent) -> None:
        seen[:] = [event.data_out.mip_primal_bound, event.data_out.mip_dual_bound]

    solver.HandleUserInterrupt = True
    solver.cbMipInterrupt += look
    solver.startSolve()  # in a thread, so that this one hears the keyboard
    try:
        while not solver.wait(_LOOK_S)[0]:
            on_look(*seen)
    except KeyboardInterrupt:
        solver.cancelSolve()  # type: ignore[no-untyped-call]
        solver.wait()  # not Thread.join, which forgets a thread that it was interrupted in waiting for
        return True
    return False
