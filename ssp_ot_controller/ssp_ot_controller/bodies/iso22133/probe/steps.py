"""The records of a probe's steps, and the definition of a clause. No I/O, no clock.

Times are those at which this machine sent and read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from ssp_core.clock import NS_PER_S
from ssp_core.run_file.model import Limits
from ssp_core.safety.consistency import Bounds
from ssp_ot_controller.bodies.iso22133.framing import Header
from ssp_ot_controller.bodies.iso22133.link import ReceivedMessage
from ssp_ot_controller.bodies.iso22133.messages import DecodedMessage, Message, Monr
from ssp_ot_controller.bodies.iso22133.probe_report import Outcome, Stage
from ssp_ot_controller.bodies.iso22133.units import nearest_utc_ns

# Those of a probe; a session has its site's.
LIMITS = Limits(speed_mps=20.0, acceleration_mps2=4.0, duration_s=600.0)
# The steps in which it is driven.
DRIVES = ("normal_stop", "abort", "loss")
# A report that is older by more isn't one that another overtook: its clock was set back.
_OVERTAKEN_NS = NS_PER_S


@dataclass(frozen=True, slots=True)
class ProbeFrame:
    """A frame that went out."""

    stamp_ns: int
    header: Header
    message: Message
    data: bytes


@dataclass(slots=True)
class Step:
    """The record of one step of a probe.

    Args:
        marks: instants of the step by their names, ns.
        problem: why it ended early.
        bounds: by which the object's stated motion is judged.
    """

    begin_ns: int
    sent: list[ProbeFrame] = field(default_factory=list)
    came: list[ReceivedMessage] = field(default_factory=list)
    marks: dict[str, int] = field(default_factory=dict)
    problem: str = ""
    bounds: Bounds = field(default_factory=Bounds)

    def monrs(self) -> list[tuple[ReceivedMessage, Monr]]:
        return [
            (r, r.outcome.message)
            for r in self.came
            if isinstance(r.outcome, DecodedMessage) and isinstance(r.outcome.message, Monr)
        ]

    def monrs_in_order(self) -> list[tuple[ReceivedMessage, Monr]]:
        """Return the reports without those that the network delivered behind a newer one."""
        reports: list[tuple[ReceivedMessage, Monr]] = []
        newest_ns: int | None = None
        for received, monr in self.monrs():
            if monr.time_of_week_ns is not None:
                stamp_ns = nearest_utc_ns(monr.time_of_week_ns, received.stamp_ns)
                if newest_ns is not None and 0 < newest_ns - stamp_ns < _OVERTAKEN_NS:
                    continue
                newest_ns = stamp_ns
            reports.append((received, monr))
        return reports

    def last_sent(self, *kinds: type) -> ProbeFrame | None:
        return next((s for s in reversed(self.sent) if isinstance(s.message, kinds)), None)


@dataclass(frozen=True, slots=True)
class Finding:
    """The finding of a clause; see ``Row``."""

    verdict: Outcome
    text: str = ""
    measured: float | None = None
    sent: tuple[bytes, ...] = ()
    came: tuple[bytes, ...] = ()


Judge = Callable[[Step, "ProbeClause", Mapping[str, Step]], Finding]


@dataclass(frozen=True, slots=True)
class ProbeClause:
    """One expectation.

    Args:
        id: its stage, a dot and its name.
        step: what is judged.
        bound: the largest value that passes; None for states and for values that aren't judged.
    """

    id: str
    step: str
    title: str
    judge: Judge
    bound: float | None = None
    unit: str = ""

    @property
    def stage(self) -> Stage:
        return Stage(self.id.partition(".")[0])


def within(
    clause: ProbeClause, measured: float, text: str = "", **evidence: tuple[bytes, ...]
) -> Finding:
    good = clause.bound is None or abs(measured) <= clause.bound
    return Finding(Outcome.PASS if good else Outcome.FAIL, text, measured, **evidence)


def silent(step: Step) -> Finding:
    return Finding(Outcome.FAIL, step.problem or "no MONR came")
