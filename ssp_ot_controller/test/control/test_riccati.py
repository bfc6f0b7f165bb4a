"""The Riccati equation is solved as SciPy solves it, without SciPy in the processes of nodes."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are  # type: ignore[import-untyped]

from ssp_ot_controller.control.riccati import cost_to_go

SPEEDS_MPS = (0.5, 5.0, 20.0, 50.0)


@pytest.mark.parametrize("share", [0.02, 0.3, 1.0], ids=["slow", "quick", "without a lag"])
@pytest.mark.parametrize("speed_mps", SPEEDS_MPS)
def test_a_steered_body_costs_what_scipy_says(speed_mps: float, share: float) -> None:
    step = speed_mps * 0.02
    a = np.array([[1.0, step, 0.5 * step**2], [0.0, 1.0, step], [0.0, 0.0, 1.0 - share]])
    b = np.array([[0.0], [0.0], [share]])
    cost, effort = np.diag([1.0, 4.0, 0.0]), np.array([[200.0]])
    expected = solve_discrete_are(a, b, cost, effort)
    assert cost_to_go(a, b, cost, effort) == pytest.approx(expected, rel=1e-8)


def test_several_inputs_at_several_prices() -> None:
    a = np.array([[1.2, 0.4], [-0.3, 0.9]])
    b = np.array([[0.5, 0.1], [0.0, 2.0]])
    cost, effort = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([[3.0, 0.2], [0.2, 0.7]])
    p = cost_to_go(a, b, cost, effort)
    assert p == pytest.approx(solve_discrete_are(a, b, cost, effort), rel=1e-10)
    back = np.linalg.solve(effort + b.T @ p @ b, b.T @ p @ a)
    assert cost + a.T @ p @ (a - b @ back) == pytest.approx(p, rel=1e-10)


def test_a_growing_state_out_of_reach_is_refused() -> None:
    one = np.array([[1.0]])
    with pytest.raises(ValueError, match="no bounded solution"):
        cost_to_go(2.0 * one, 0.0 * one, one, one)


def test_the_nodes_of_objects_start_without_scipy() -> None:
    """Importing it, and its solver, cost each node 0.4 s of processor time."""
    code = "import sys, ssp_ot_controller.control.tracker; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
