"""The time at which a commanded stop has slowed an object, by the places that it reports."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from ssp_ot_controller.bodies.iso22133.framing import Header
from ssp_ot_controller.bodies.iso22133.link import ReceivedMessage
from ssp_ot_controller.bodies.iso22133.messages import DecodedMessage, MessageId, Monr
from ssp_ot_controller.bodies.iso22133.probe.clauses import CLAUSES
from ssp_ot_controller.bodies.iso22133.probe.steps import Finding, Step
from ssp_ot_controller.bodies.iso22133.probe_report import Outcome

S = 1_000_000_000
BEGIN_NS = 1_700_000_000 * S
PERIOD_S = 0.01
STIMULUS_S = 2.0
(ABORT,) = (clause for clause in CLAUSES if clause.id == "move.abort")


def stopped(speed: Callable[[float], float], seconds: float = 12.0) -> Finding:
    """Return the probe's finding of an object that drives at this speed, by seconds of the step."""
    step, x_m = Step(BEGIN_NS), 0.0
    for k in range(round(seconds / PERIOD_S)):
        x_m += speed(k * PERIOD_S) * PERIOD_S
        monr = Monr(None, x_m, 0.0, 0.0, 0.0, *[None] * 7, 4, None, 0, 0)
        at_ns = BEGIN_NS + round(k * PERIOD_S * S)
        step.came.append(
            ReceivedMessage(True, at_ns, DecodedMessage(Header(MessageId.MONR), monr), b"")
        )
    step.marks["stimulus"] = BEGIN_NS + round(STIMULUS_S * S)
    return ABORT.judge(step, ABORT, {})


@pytest.mark.parametrize("late_s", [0.1, 0.5, 0.8])
def test_a_stop_is_measured_from_the_stimulus(late_s: float) -> None:
    found = stopped(lambda t: max(min(3.0, 3.0 - 3.0 * (t - STIMULUS_S - late_s)), 0.0))
    assert (found.verdict, found.text[:12]) == (Outcome.PASS, "at 3.00 m/s;")
    # Half a metre a second less, over a fifth of a second.
    assert found.measured == pytest.approx(late_s + 0.2, abs=0.1)


def test_an_uneven_pace_is_no_stop() -> None:
    """The demonstration object of RI-SE on a busy machine: it drove on to its way's end."""

    def speed(t: float) -> float:
        return 0.0 if t > 8.0 else 1.9 if STIMULUS_S < t % 1.0 + 2.0 < STIMULUS_S + 0.3 else 3.0

    found = stopped(speed)
    assert found.verdict is Outcome.FAIL
    assert found.measured == pytest.approx(6.0, abs=0.2)


def test_one_that_never_stands_fails() -> None:
    found = stopped(lambda t: 3.0 if t < STIMULUS_S else 1.0)
    assert found.verdict is Outcome.FAIL
    assert "it still moves" in found.text
