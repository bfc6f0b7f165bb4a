"""Proposed labels on disk, and their review: label by label, a person accepts or edits them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ssp_core.decimals import decimal
from ssp_core.errors import InputError
from ssp_core.files.reading import read_mapping
from ssp_core.files.writing import write_json
from ssp_core.hashing import sha256_file
from ssp_core.vocabulary import (
    CONFLICTS,
    LAT_ACTIONS,
    LON_ACTIONS,
    MOTIONS,
    OBJECTS,
    PHASES,
    POSITIONS,
)
from ssp_eval.data.labels import BY_PHASE, Labels, labels_to_json, load_labels, parse_labels
from ssp_eval.labels.check import phase_problems, plan_problems, response_problems, risk_warnings
from ssp_eval.labels.propose import Proposal
from ssp_scenario_manager.event_spec.log import Record, append_records
from ssp_scenario_manager.review.dialogue import (
    QUIT,
    FileUnderReview,
    Terminal,
    ask_reason,
    decide,
)

SCHEMA = "ssp.proposal/1"
# Key of the sidecar of labels that are under review: the fields that were decided.
_DECIDED = "decided"


def sidecar(labels: Path) -> Path:
    """Return the path of the mark beside a labels file."""
    return labels.with_name(f"{labels.stem}.proposal.json")


@dataclass(frozen=True)
class NewFile:
    """A labels file or template that is to be written.

    Args:
        mark: what its sidecar says besides its hash; None: it has none, as a template.
    """

    path: Path
    content: Mapping[str, Any]
    mark: Mapping[str, Any] | None = None


def proposed_file(path: Path, proposal: Proposal, source: str) -> NewFile:
    """Return proposed labels and their mark, to be written.

    Args:
        path: of the labels file.
        proposal: labels, event and crop.
        source: hash or name of what they were made from.
    """
    mark = {"source": source, "event": asdict(proposal.event), "crop": asdict(proposal.crop)}
    return NewFile(path, labels_to_json(proposal.labels), mark)


def write_files(files: Sequence[NewFile]) -> None:
    """Write all files and their marks, or none of them."""
    staged: list[tuple[Path, Path]] = []
    try:
        for file in files:
            labels = file.path.with_name(f".{file.path.name}.new")
            staged.append((labels, file.path))
            write_json(labels, file.content)
            if file.mark is not None:
                mark, digest = sidecar(labels), sha256_file(labels)
                staged.append((mark, sidecar(file.path)))
                write_json(mark, {"schema": SCHEMA, "labels_sha256": digest, **file.mark})
        for file in files:
            if file.mark is None:  # of a proposal that this file replaces
                sidecar(file.path).unlink(missing_ok=True)
        for scratch, target in staged:
            scratch.replace(target)
    finally:
        for scratch, _ in staged:
            scratch.unlink(missing_ok=True)


def write_proposal(path: Path, proposal: Proposal, source: str) -> None:
    """Write proposed labels and their mark; see proposed_file."""
    write_files([proposed_file(path, proposal, source)])


def is_unreviewed(path: Path) -> bool:
    """Return True for labels that stand as they were proposed, or whose review isn't finished.

    Raises:
        InputError: the sidecar can't be read.
    """
    mark = sidecar(path)
    if not mark.is_file():
        return False
    value = read_mapping(mark)
    return _DECIDED in value or value.get("labels_sha256") == sha256_file(path)


def decided_fields(path: Path) -> frozenset[str]:
    """Return the fields that an unfinished review has decided, such as ``labels[3]``.

    Raises:
        InputError: the sidecar can't be read.
    """
    value = read_mapping(sidecar(path)).get(_DECIDED, [])
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise InputError(
            "must be a list of fields",
            file=sidecar(path),
            field=_DECIDED,
            value=value,
            remedy="write the names of fields in a list",
        )
    return frozenset(value)


def write_decided(path: Path, labels: Labels, decided: Iterable[str]) -> None:
    """Write labels under review, the mark first: they never look reviewed before they are."""
    mark: dict[str, Any] = read_mapping(sidecar(path))
    mark[_DECIDED] = sorted(decided)
    write_json(sidecar(path), mark)
    write_json(path, labels_to_json(labels))
    mark["labels_sha256"] = sha256_file(path)
    write_json(sidecar(path), mark)


def confirm(path: Path) -> None:
    """Take the mark off: a person has decided every label."""
    sidecar(path).unlink(missing_ok=True)


PROMPT = "  [a]ccept [e]dit [s]kip [q]uit [?] > "
_HELP = """  a  accept the label as it is
  e  change slots, such as: motion=stationary lon_actions=decelerate,stop conflict=null
  s  skip it for now
  q  stop here; what was decided is kept, and the same command goes on"""
_RISK = "risk_time_s"
_PAIR = re.compile(r"(\w+)=(\S*)")
_LISTS = {"objects": OBJECTS, "lon_actions": LON_ACTIONS, "lat_actions": LAT_ACTIONS}
_WORDS = {"phase": PHASES, "position": POSITIONS, "motion": MOTIONS, "conflict": CONFLICTS}


class _BadLine(Exception):
    """The error for a typed line that is no change of a label; the message says why."""


@dataclass
class _Desk:
    """A labels file under review: every decision is on the disk before the next question."""

    path: Path
    log: Path
    who: str
    now: Callable[[], str]
    labels: Labels
    decided: set[str]

    def __post_init__(self) -> None:
        self._file = FileUnderReview(self.path)

    def record(self, reason: str, field: str | None, old: Any, new: Any, **details: Any) -> Record:
        return Record(
            kind="label_review",
            when=self.now(),
            who=self.who,
            subject=f"{self.labels.scenario} {self.labels.domain}",
            version=self._file.digest,
            field=field,
            old=old,
            new=new,
            reason=reason,
            details=details,
        )

    def decide(self, field: str, after: Labels, records: list[Record]) -> None:
        self._file.check()
        append_records(self.log, records)
        self.decided.add(field)
        write_decided(self.path, after, self.decided)
        self.labels = after
        self._file.written()


def review_labels(
    path: Path, log: Path, who: str, now: Callable[[], str], terminal: Terminal
) -> int:
    """Go through proposed labels; exit status 0 when every one is decided.

    Raises:
        InputError: the file is no labels file, or is a template.
    """
    labels = load_labels(path)
    if not is_unreviewed(path):
        terminal.say(f"{path}: is not marked as a proposal; there is nothing to review")
        return 0
    desk = _Desk(path, log, who, now, labels, set(decided_fields(path)))
    fields = [_RISK, *(f"labels[{i}]" for i in range(len(labels.labels)))]
    waiting = [field for field in fields if field not in desk.decided]
    for number, field in enumerate(waiting, start=1):
        _show(desk.labels, field, f"[{number}/{len(waiting)}]", terminal)
        if not _ask(desk, field, terminal):
            break
    left = [field for field in fields if field not in desk.decided]
    problems = [*phase_problems(desk.labels), *plan_problems(desk.labels)]
    for problem in problems:
        terminal.say(f"! {problem}")
    for warning in [*response_problems(desk.labels), *risk_warnings(desk.labels)]:
        terminal.say(f"warning: {warning}")
    if left or problems:
        what = f"{len(left)} left to decide: {', '.join(left)}" if left else "phases contradict"
        terminal.say(f"\n{path}: {what}")
        return 1
    reason = "every label was decided"
    append_records(log, [desk.record(reason, None, None, None, sidecar=sidecar(path).name)])
    confirm(path)
    terminal.say(f"\n{path}: reviewed, {sha256_file(path)}")
    return 0


def _show(labels: Labels, field: str, number: str, terminal: Terminal) -> None:
    label = _holder(labels_to_json(labels), field)
    if field == _RISK:
        value = label[_RISK]
        terminal.say(f"\n{number} {field}: {'null' if value is None else f'{value:g} s'}")
        return
    terminal.say(f"\n{number} {field}, t = {label['t_s']:g} s")
    for slot, slot_value in label.items():
        if slot != "t_s":
            terminal.say(f"  {slot:<13}{_text(slot_value)}")


def _ask(desk: _Desk, field: str, terminal: Terminal) -> bool:
    """Ask until one field is decided or skipped; return False when the review stops."""
    acts = {
        "accept": lambda: _accept(desk, field),
        "edit": lambda: _edit(desk, field, terminal),
        "skip": lambda: True,
    }
    return decide(terminal, PROMPT, _HELP, acts) != QUIT


def _accept(desk: _Desk, field: str) -> bool:
    value: Any = _holder(labels_to_json(desk.labels), field)
    value = value[_RISK] if field == _RISK else value
    desk.decide(field, desk.labels, [desk.record("agrees with the frames", field, value, value)])
    return True


def _edit(desk: _Desk, field: str, terminal: Terminal) -> bool:
    prompt = "  new time, s, or null> " if field == _RISK else "  slot=value …> "
    text = terminal.ask(prompt)
    if text is None:
        return False
    content = labels_to_json(desk.labels)
    try:
        changes = _risk_change(text) if field == _RISK else _changes(text)
        if "phase" in changes and desk.labels.plan == BY_PHASE:
            raise _BadLine("the phase of a label is its plan's; change the plan (ssp labels new)")
        holder = _holder(content, field)
        old = {slot: holder[slot] for slot in changes}
        holder |= changes
        after = parse_labels(content, desk.path)
    except _BadLine as error:
        terminal.say(f"  not understood: {error}")
        return False
    except InputError as error:
        remedy = f"; {error.remedy}" if error.remedy else ""
        terminal.say(f"  ! {error.field}: {error.problem}{remedy}")
        return False
    reason = ask_reason(terminal)
    if reason is None:
        terminal.say("  nothing was changed")
        return False
    new = _holder(labels_to_json(after), field)
    records = [
        desk.record(reason, slot if slot == _RISK else f"{field}.{slot}", was, new[slot])
        for slot, was in old.items()
    ]
    desk.decide(field, after, records)
    for problem in phase_problems(after):
        terminal.say(f"  ! {problem}")
    return True


def _risk_change(text: str) -> dict[str, Any]:
    if text == "null":
        return {_RISK: None}
    try:
        return {_RISK: decimal(text.removesuffix("s"))}
    except ValueError:
        raise _BadLine("type a clip time in seconds, or null") from None


def _changes(text: str) -> dict[str, Any]:
    """Return the slots and their new values in a typed line."""
    pairs = _PAIR.findall(text)
    if not pairs or _PAIR.sub("", text).strip():
        raise _BadLine("type slots and values, such as: motion=stationary conflict=null")
    changes: dict[str, Any] = {}
    for slot, new_value in pairs:
        if slot == "risk_visible":
            if new_value not in ("true", "false"):
                raise _BadLine("risk_visible is true or false")
            changes[slot] = new_value == "true"
        elif slot in _LISTS:
            changes[slot] = (
                None if new_value == "null" else [word for word in new_value.split(",") if word]
            )
        elif slot in _WORDS:
            changes[slot] = None if new_value == "null" else new_value
        else:
            slots = ", ".join([*_WORDS, *_LISTS, "risk_visible"])
            raise _BadLine(f"there is no slot {slot!r}; known: {slots}")
    return changes


def _holder(content: dict[str, Any], field: str) -> dict[str, Any]:
    """Return the mapping of the decided values: the file for risk_time_s, else labels[i]."""
    holder: dict[str, Any] = content
    if field != _RISK:
        holder = content["labels"][int(field.removeprefix("labels[").removesuffix("]"))]
    return holder


def _text(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(part)}" for key, part in value.items())
    if isinstance(value, bool):
        return str(value).lower()
    return ", ".join(value) or "(none)" if isinstance(value, list) else str(value)
