"""The discrete algebraic Riccati equation of linear-quadratic regulators.

Solved by structure-preserving doubling (Chu, Fan, Lin and Wang, 2004): after n rounds the solution
is that of a horizon of 2^n steps, so that some ten rounds of small products suffice. SciPy's solver
gives the same; importing it and its QZ decomposition cost each process half a second.
"""

from __future__ import annotations

import numpy as np

from ssp_core.geometry import FloatArray

# A horizon of 2^40 steps: no closed loop that steers an object takes so long.
_MAX_ROUNDS = 40
_ENOUGH = 1e-15


def cost_to_go(a: FloatArray, b: FloatArray, cost: FloatArray, effort: FloatArray) -> FloatArray:
    """Return P of x' P x, the least sum of x' ``cost`` x + u' ``effort`` u over all later steps.

    Args:
        a: a step is x -> ``a`` x + ``b`` u; shape (n, n).
        b: shape (n, m).
        cost: symmetric and positive semidefinite, shape (n, n).
        effort: symmetric and positive definite, shape (m, m).

    Raises:
        ValueError: the sum has no limit, because ``b`` doesn't reach a state that grows.
    """
    unit = np.eye(len(a))
    own, reach, p = a, b @ np.linalg.solve(effort, b.T), cost
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_MAX_ROUNDS):
            shared = np.linalg.inv(unit + reach @ p)
            onward = own @ shared
            more = own.T @ p @ shared @ own
            reach = reach + onward @ reach @ own.T
            own = onward @ own
            p = p + more
            if np.abs(more).max() <= _ENOUGH * np.abs(p).max() < np.inf:
                return (p + p.T) / 2
    raise ValueError("the Riccati equation has no bounded solution")
