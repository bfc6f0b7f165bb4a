"""What a compiled task's log L says: where it came from, what was tuned, chosen and validated."""

from __future__ import annotations

import datetime
import os
from collections.abc import Sequence

from ssp_core.errors import InputError
from ssp_core.run_file.shortlist import Listed
from ssp_scenario_manager.compile.choose import Chosen
from ssp_scenario_manager.compile.task import Task, Validation
from ssp_scenario_manager.spec.log import Record
from ssp_scenario_manager.spec.model import Event, Interval

COMPILER = "ssp compile"
# The compiler's own entries say the same whenever it runs, so that the same input gives the same
# bytes; only a person's decision has a time.
NO_TIME = "1970-01-01T00:00:00Z"


def compiler_time() -> str:
    """The time of the compiler's own entries: SOURCE_DATE_EPOCH, or the epoch's start.

    Raises:
        InputError: SOURCE_DATE_EPOCH is no number of seconds.
    """
    given = os.environ.get("SOURCE_DATE_EPOCH")
    if not given:
        return NO_TIME
    try:
        moment = datetime.datetime.fromtimestamp(int(given), datetime.UTC)
    except (ValueError, OverflowError, OSError) as error:
        raise InputError(
            "must be seconds since 1970", field="SOURCE_DATE_EPOCH", value=given
        ) from error
    return moment.strftime("%Y-%m-%dT%H:%M:%SZ")


def source_record(event: Event, version: str) -> Record:
    """Where the event was taken from (METHOD 1, source gate)."""
    clip = event.events.clip
    return Record(
        kind="source",
        when=compiler_time(),
        who=COMPILER,
        subject=event.name,
        version=version,
        reason="the clip that the event was taken from, as its K* says",
        details={
            "generator": event.source.generator,
            "original": event.source.original,
            "sha256": event.source.sha256,
            "crop": {"start": _span(clip.start), "end": _span(clip.end)},
        },
    )


def _span(value: object) -> object:
    return value.model_dump(mode="json") if isinstance(value, Interval) else value


def tuning_records(task: Task) -> list[Record]:
    """One entry per value that was chosen within part C (METHOD 2.3)."""
    return [
        Record(
            kind="tuning",
            when=compiler_time(),
            who=COMPILER,
            subject=task.event.name,
            version=task.event.version,
            field=tuning.field,
            old={"min": tuning.min, "max": tuning.max, "unit": tuning.unit},
            new=tuning.value,
            reason=tuning.reason,
            details={"task_version": task.version, "unit": tuning.unit},
        )
        for tuning in task.tunings
    ]


def choice_record(task: Task, chosen: Chosen, who: str, when: str) -> Record:
    """A person's choice between ties (METHOD 2.2)."""
    return Record(
        kind="choice",
        when=when,
        who=who,
        subject=task.event.name,
        version=task.event.version,
        field="block",
        new=task.block.id,
        reason=f"at least {len(chosen.tied)} blocks of {task.place.name} score alike and fit",
        details={"task_version": task.version, "tied": list(chosen.tied)},
    )


def shortlist_record(task: Task, candidate: Listed, sha256: str) -> Record:
    """The list of the two virtual stages that chose the event for the track.

    Args:
        task: sealed.
        candidate: its entry.
        sha256: hash of the list's file.
    """
    return Record(
        kind="shortlist",
        when=compiler_time(),
        who=COMPILER,
        subject=task.event.name,
        version=task.event.version,
        reason="; ".join(candidate.reasons),
        details={
            "task_version": task.version,
            "sha256": sha256,
            "rank": candidate.rank,
            "priority": candidate.priority,
        },
    )


def validation_record(task: Task, validation: Validation) -> Record:
    """The simulation run that validated the anchors (METHOD 2)."""
    return Record(
        kind="validation",
        when=compiler_time(),
        who=COMPILER,
        subject=task.event.name,
        version=task.event.version,
        new=validation.run_id,
        reason="its chosen values are the preferred ones of this task",
        details={"task_version": task.version, **validation.model_dump(mode="json")},
    )


def disclosure_records(task: Task, left_out: Sequence[str]) -> list[Record]:
    """Surroundings of the place that the event leaves out."""
    return [
        Record(
            kind="disclosure",
            when=compiler_time(),
            who=COMPILER,
            subject=task.event.name,
            version=task.event.version,
            field="run.traffic",
            reason=f"left out of the surroundings: {text}",
            details={"task_version": task.version},
        )
        for text in left_out
    ]
