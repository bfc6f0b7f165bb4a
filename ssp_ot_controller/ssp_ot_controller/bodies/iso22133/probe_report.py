"""Report of a probe of one object (``ssp.iso_probe/1``), and what is decided by it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AwareDatetime, ConfigDict, Field

from ssp_core.files.reading import load_model
from ssp_core.files.writing import write_json
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.run_file.values import Finite, Strict
from ssp_core.safety.consistency import Bounds, direction_bound_rad
from ssp_core.vocabulary import ObjectClass, ObjectWord

PROBE_SCHEMA: Literal["ssp.iso_probe/1"] = "ssp.iso_probe/1"
# Clauses that decide how an object is driven.
NORMAL_STOP = "move.normal_stop"
STOP_ON_ABORT = "move.abort"
STOP_ON_HEARTBEAT_LOSS = "move.heartbeat_loss"
START_TIME = "move.start_time"
STATE_AGE = "move.age"
CLOCK = "move.clock"
# An object is armed only if all of these are measured within the site's limits, which say how soon
# it must slow.
STOPS = {
    NORMAL_STOP: "a normal stop",
    STOP_ON_ABORT: "an abort",
    STOP_ON_HEARTBEAT_LOSS: "lost heartbeats",
}
# And within these; each with what it measures, and the limit.
TIMES = {
    STATE_AGE: ("the age of its newest MONR that can be used", "state_age_s"),
    CLOCK: ("stamps ahead of time", "clock_offset_s"),
}
NEEDED = {
    "listen.values": "states only values of its enumerations",
    "arm.arm": "arms on command",
    "arm.disarm": "disarms on command",
    "arm.abort": "aborts on command",
    "arm.latch": "keeps an abort",
    "arm.all_clear": "is cleared by an all clear",
    "arm.heartbeat_loss": "leaves ARMED without heartbeats",
    "arm.reconnect": "isn't ARMED when it is connected again",
    START_TIME: "starts at the time of the STRT",
    "move.way": "keeps to its way",
    "move.motion": "states the speed and the yaw with which it moves",
    "move.position": "knows its place while it drives",
    "move.running": "reports RUNNING while it drives",
    "move.postrun": "reports POSTRUN while it is stopped",
}

Hex = Annotated[str, Field(pattern=r"^([0-9a-f]{2})*$")]


class Stage(StrEnum):
    """Stages of a probe; each needs those before it."""

    LISTEN = "listen"
    CONNECT = "connect"
    ARM = "arm"
    MOVE = "move"


class Outcome(StrEnum):
    """The outcome of a clause."""

    PASS = "pass"
    FAIL = "fail"
    NOT_RUN = "not_run"
    # Measured, and judged by nobody.
    INFO = "info"


class Row(Strict):
    """One clause.

    Args:
        sent: frames that asked for it, those that show it best.
        came: frames or damaged bytes that are the evidence.
        measured: None where there is no such number, as for an object that never slowed.
        text: what was found, for people.
    """

    clause: str
    stage: Stage
    title: str
    verdict: Outcome
    sent: tuple[Hex, ...] = ()
    came: tuple[Hex, ...] = ()
    measured: Finite | None = None
    bound: Finite | None = None
    unit: str = ""
    text: str = ""


@dataclass(frozen=True, slots=True)
class ObjectKind:
    """The kind of an object, which says how its yaw may lie to its motion."""

    object_class: ObjectClass
    omnidirectional: bool = False

    @staticmethod
    def of(spec: ParticipantSpec, limits: Limits) -> ObjectKind:
        """Return the kind of an object of a run."""
        return ObjectKind(spec.cls, spec.id in limits.omnidirectional)

    @property
    def bounds(self) -> Bounds:
        """Return the bounds by which its stated motion is judged."""
        bound_rad = None if self.omnidirectional else direction_bound_rad(self.object_class)
        return Bounds(bound_rad, self.object_class is not ObjectClass.PEDESTRIAN)

    @property
    def options(self) -> str:
        """Return the options of ``ssp iso probe`` for it."""
        omnidirectional = " --omnidirectional" if self.omnidirectional else ""
        return f"--class {self.object_class.word}{omnidirectional}"

    def is_laxer(self, other: ObjectKind) -> bool:
        """Tell whether what is judged as this kind may fail as another one."""
        ours, theirs = self.bounds, other.bounds
        if theirs.direction_rad is None:
            return False
        if ours.direction_rad is None or ours.direction_rad > theirs.direction_rad:
            return True
        return theirs.signed and not ours.signed


CAR = ObjectKind(ObjectClass.CAR)


class ProbeReport(Strict):
    """The file.

    Args:
        firmware: as the object's DRES states it; None where it answers no DREQ.
        started: UTC.
        object_class: by which its stated motion was judged.
        omnidirectional: its yaw was not held against its motion.
        stages: those that were asked for.
    """

    schema_: Literal["ssp.iso_probe/1"] = Field(PROBE_SCHEMA, alias="schema")
    host: str
    port: Annotated[int, Field(ge=2, le=65535)]
    firmware: str | None
    started: AwareDatetime
    wire_version: int
    object_class: ObjectWord = "car"
    omnidirectional: bool = False
    stages: tuple[Stage, ...]
    rows: tuple[Row, ...]

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @property
    def kind(self) -> ObjectKind:
        return ObjectKind(ObjectClass.from_word(self.object_class), self.omnidirectional)

    def row(self, clause: str) -> Row | None:
        return next((row for row in self.rows if row.clause == clause), None)


def load_report(path: str | Path) -> ProbeReport:
    """Return the report in a file.

    Raises:
        InputError: the file can't be read, or isn't a probe report.
    """
    return load_model(ProbeReport, path)


def write_report(path: str | Path, report: ProbeReport) -> None:
    """Raise InputError or HostError where the file can't be written."""
    write_json(path, report.model_dump(mode="json", by_alias=True))


def _measured(report: ProbeReport, clause: str) -> float | None:
    row = report.row(clause)
    return row.measured if row is not None and row.verdict is not Outcome.NOT_RUN else None


def stops_on_abort_s(report: ProbeReport) -> float | None:
    """Return the time from the abort to the first slowing of an object that then stood.

    None: it didn't.
    """
    return _measured(report, STOP_ON_ABORT)


def stops_on_heartbeat_loss_s(report: ProbeReport) -> float | None:
    """Return ``stops_on_abort_s`` from the last heartbeat, with the timeout that the OSEM gave."""
    return _measured(report, STOP_ON_HEARTBEAT_LOSS)


def honours_start_time(report: ProbeReport) -> float | None:
    """Return how late it started (+), s, where that is within the bound; None: it isn't shown."""
    row = report.row(START_TIME)
    return row.measured if row is not None and row.verdict is Outcome.PASS else None


def cannot_arm(
    report: ProbeReport | None,
    limits: Limits,
    firmware: str | None,
    waived_by: str | None,
    kind: ObjectKind = CAR,
) -> tuple[str, ...]:
    """List all reasons for which an object must not be armed, as sentences; none where it may be.

    Args:
        report: of the object's last probe; None: there is none.
        limits: of the site.
        firmware: as the object's DRES states it; None where it answers no DREQ, as it must have
            done when it was probed.
        waived_by: the name of a person who answers for the object instead of a report.
        kind: of the object in the run.
    """
    if waived_by and waived_by.strip():
        return ()
    if report is None:
        return ("it has no probe report: run `ssp iso probe --stage move`, or waive it by a name",)
    reasons = []
    if report.firmware != firmware:
        firmware_text, probed = firmware or "unknown", report.firmware or "unknown"
        reasons.append(
            f"its firmware is {firmware_text}, the probe report of {_day(report.started)} is of "
            f"{probed}"
        )
    if report.kind.is_laxer(kind):
        reasons.append(
            f"its probe report judges its motion by `{report.kind.options}`: probe it with "
            f"`{kind.options}`"
        )
    lacks = [
        f"{what} ({clause})"
        for clause, what in NEEDED.items()
        if (row := report.row(clause)) is None or row.verdict is not Outcome.PASS
    ]
    for clause, what in STOPS.items():
        reaction_s, bound_s = _measured(report, clause), limits.stop_reaction_s
        if reaction_s is None:
            lacks.append(f"stops on {what} ({clause})")
        elif reaction_s > bound_s:
            reasons.append(
                f"its probe report shows {reaction_s:.3f} s from {what} to the first slowing, the "
                f"site allows {bound_s:g} s ({clause})"
            )
    for clause, (what, limit) in TIMES.items():
        measured_s, bound_s = _measured(report, clause), float(getattr(limits, limit))
        if measured_s is None:
            lacks.append(f"keeps limits.{limit} ({clause})")
        elif measured_s > bound_s:
            reasons.append(
                f"its probe report shows {measured_s:.3f} s, {what}; the site allows {bound_s:g} s "
                f"({clause})"
            )
    if lacks:
        reasons.append(f"its probe report doesn't show that it {', '.join(lacks)}")
    return tuple(reasons)


def _day(when: datetime) -> str:
    return when.date().isoformat()
