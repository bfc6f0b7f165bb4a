"""Was the run that was recorded the one that was compiled? Seals, hashes, changes on site."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ssp_core.bag.reader import BagReader
from ssp_core.errors import InputError
from ssp_core.files import parse_mapping, parse_model
from ssp_core.run_file.model import RunSpec
from ssp_eval.audit.model import ChangeEntry
from ssp_eval.audit.reasons import Finding
from ssp_eval.recordings.provenance import bag_folder
from ssp_scenario_manager.compile.changes import differences, explained
from ssp_scenario_manager.compile.targets.folder import TASK_FOLDER
from ssp_scenario_manager.compile.task import EVENT_FILE, SITE_FILE, TASK_FILE, Task, content_hash
from ssp_scenario_manager.event_spec.load import event_version
from ssp_scenario_manager.event_spec.log import LOG_FILE, Record, parse_log, read_log
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.site import Site, site_version


@dataclass(frozen=True)
class Attached:
    """What the recorder attached to a bag, as far as it could be read.

    Args:
        task: None: there is none, or none that is valid.
        event: the K*; its own seal is its hash.
        site: None also for a run that was placed on a map.
        records: of the log L.
        later: entered into the log beside the recording after the run.
        findings: why something can't be used.
    """

    task: Task | None
    event: Event | None
    site: Site | None
    records: tuple[Record, ...]
    later: tuple[Record, ...]
    findings: tuple[Finding, ...]


def read_attached(bag: BagReader) -> Attached:
    """Reads task, K*, site and log of a recording; what is wrong with them becomes findings."""
    findings: list[Finding] = []

    def data_of(name: str) -> bytes | None:
        try:
            return bag.attachment(name)
        except InputError as error:
            findings.append(Finding("seal_broken", _told(error, bag)))
            return None

    task = event = site = None
    records: tuple[Record, ...] = ()
    later: tuple[Record, ...] = ()
    task_data = data_of(TASK_FILE)
    if task_data is None and not findings:
        findings.append(Finding("not_compiled", f"the bag has no attachment {TASK_FILE}"))
    try:
        if task_data is not None:
            place = f"{bag.path}:{TASK_FILE}"
            task = parse_model(Task, parse_mapping(task_data, place), place)
        if (found := data_of(EVENT_FILE)) is not None:
            place = f"{bag.path}:{EVENT_FILE}"
            event = parse_model(Event, parse_mapping(found, place), place)
        if (found := data_of(SITE_FILE)) is not None:
            place = f"{bag.path}:{SITE_FILE}"
            site = parse_model(Site, parse_mapping(found, place), place)
        if (found := data_of(LOG_FILE)) is not None:
            text = found.decode("utf-8", errors="replace")
            records = tuple(parse_log(text, f"{bag.path}:{LOG_FILE}"))
            later = _later(bag_folder(bag.path).parent / TASK_FOLDER / LOG_FILE, records)
    except InputError as error:
        findings.append(Finding("seal_broken", _told(error, bag)))
    findings += _seals(task, event, site)
    return Attached(task, event, site, records, later, tuple(findings))


def _told(error: InputError, bag: BagReader) -> str:
    """What is wrong, in the same words wherever the recording lies: an audit can be made again."""
    folder = bag_folder(bag.path)
    text = str(error).replace(str(bag.path), folder.name)
    return text.replace(f"{folder.parent}/", "")


def _later(beside: Path, recorded: tuple[Record, ...]) -> tuple[Record, ...]:
    """Entries of the log beside a recording that came after those in it.

    Raises:
        InputError: it doesn't begin with what was recorded: somebody rewrote it.
    """
    found = tuple(read_log(beside))
    if found and found[: len(recorded)] != recorded:
        raise InputError(
            "does not begin with the log in the bag",
            file=beside,
            remedy="a log is appended to and never rewritten",
        )
    return found[len(recorded) :]


def _seals(task: Task | None, event: Event | None, site: Site | None) -> list[Finding]:
    if task is None:
        return []
    found = []
    content = content_hash(task)
    if content != task.version:
        found.append(
            Finding("seal_broken", f"{TASK_FILE} says {task.version}, its content is {content}")
        )
    if event is None:
        found.append(Finding("not_compiled", f"the bag has no attachment {EVENT_FILE}"))
    elif event_version(event) != task.event.version:
        found.append(
            Finding(
                "seal_broken",
                f"{EVENT_FILE} has {event_version(event)}, the task was made from "
                f"{task.event.version}",
            )
        )
    if task.place.kind == "site":
        if site is None:
            found.append(Finding("not_compiled", f"the bag has no attachment {SITE_FILE}"))
        elif site_version(site) != task.place.sha256:
            found.append(
                Finding(
                    "seal_broken",
                    f"{SITE_FILE} has {site_version(site)}, the task was placed on "
                    f"{task.place.sha256}",
                )
            )
    return found


def site_changes(attached: Attached, executed: RunSpec) -> tuple[list[ChangeEntry], list[Finding]]:
    """Every difference between the compiled run and the one that ran, and who logged it.

    Returns:
        The changes, logged ones first, and a finding for what nobody logged.
    """
    if attached.task is None:
        return [], []
    compiled = attached.task.run
    findings, believed = [], compiled
    entries = []
    for later, records in ((False, attached.records), (True, attached.later)):
        for record in records:
            if record.kind != "site_change":
                continue
            try:
                believed = explained(believed, [record], LOG_FILE)
            except InputError as error:
                findings.append(Finding("unlogged_change", f"a record doesn't fit: {error}"))
                continue
            entries.append(
                ChangeEntry(
                    field=record.field or "",
                    old=record.old,
                    new=record.new,
                    logged=True,
                    later=later,
                    who=record.who,
                    when=record.when,
                    reason=record.reason,
                )
            )
    unlogged = differences(believed, executed)
    entries += [
        ChangeEntry(field=d.field, old=d.compiled, new=d.executed, logged=False) for d in unlogged
    ]
    if unlogged:
        shown = ", ".join(f"{d.field}: {d.compiled!r} to {d.executed!r}" for d in unlogged[:4])
        more = f" and {len(unlogged) - 4} more" if len(unlogged) > 4 else ""
        findings.append(Finding("unlogged_change", shown + more))
    return entries, findings


def disclosed(attached: Attached) -> dict[str, str]:
    """What the log discloses, by field or subject; and changes that were entered late."""
    found = {
        record.field or record.subject: record.reason
        for record in attached.records
        if record.kind == "disclosure"
    }
    for record in attached.later:
        if record.kind == "site_change":
            found[record.field or record.subject] = (
                f"changed on site, entered after the run by {record.who}: {record.reason}"
            )
    return found
