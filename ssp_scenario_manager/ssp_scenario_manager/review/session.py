"""A review from field to field: shows what is known, asks, and keeps each decision at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_bytes, write_text
from ssp_core.hashing import sha256_file
from ssp_scenario_manager.checks.base import Failure, View
from ssp_scenario_manager.checks.check import (
    UndecidedField,
    contradictions,
    is_unresolved,
    undecided,
)
from ssp_scenario_manager.checks.form import vocabulary
from ssp_scenario_manager.event_spec.fields import get, units_of, within
from ssp_scenario_manager.event_spec.load import body, event_text, event_version, load_event
from ssp_scenario_manager.event_spec.log import EntryKind, Record, append_records
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.extract.blank import changed_by_hand, with_author
from ssp_scenario_manager.extract.questions import GATE_REASONS
from ssp_scenario_manager.review.decisions import (
    NotAllowed,
    Unreadable,
    accept,
    edit,
    leave_unresolved,
    read_value,
    value_text,
)
from ssp_scenario_manager.review.dialogue import (
    QUIT,
    FileUnderReview,
    Terminal,
    ask_reason,
    decide,
)

COLUMNS = 3
TILE_PX = 640
MOST = 9


class Evidence:
    """Makes contact sheets on demand; without a video it makes none.

    Args:
        video: the source video, None: there is none at hand.
        first_frame: number of the clip's first frame in the video.
        start_s: its time.
    """

    def __init__(
        self, folder: Path, video: Path | None, first_frame: int = 0, start_s: float = 0.0
    ) -> None:
        self._folder = folder
        self._video = video
        self._first_frame = first_frame
        self._start_s = start_s
        self._frames: dict[int, tuple[float, Any]] = {}

    def prepare(self, frame_groups: Iterable[tuple[int, ...]]) -> None:
        """Decode all frames that sheets will need, in one pass.

        Raises:
            InputError: the video can't be read.
        """
        if self._video is None:
            return
        from ssp_core.video import Video

        numbers = {n for frames in frame_groups for n in spread(frames)}
        last = max(numbers, default=-1)
        with Video(self._video) as video:
            for frame in video.frames(0.0, None, 1):
                number = frame.number - self._first_frame
                if number in numbers:
                    self._frames[number] = (frame.time_s - self._start_s, frame.image)
                if number >= last:
                    break

    def sheet(self, frames: tuple[int, ...]) -> Path | None:
        """Return the contact sheet of some frames, None without video or frames."""
        from ssp_core.bag.pictures.images import encode
        from ssp_core.video import Tile, contact_sheet

        tiles = [
            Tile(self._frames[n][1], (f"frame {n}, t = {self._frames[n][0]:.3f} s",))
            for n in spread(frames)
            if n in self._frames
        ]
        if not tiles:
            return None
        numbers = spread(frames)
        path = self._folder / f"frames-{numbers[0]:06d}-{numbers[-1]:06d}-{len(numbers)}.jpg"
        if not path.is_file():
            make_folder(self._folder)
            write_bytes(path, encode(contact_sheet(tiles, COLUMNS, TILE_PX), ".jpg", 90))
        return path


def spread(frames: tuple[int, ...]) -> tuple[int, ...]:
    """Return at most nine frames to show: the evidence, with more inside a span of two."""
    if len(frames) == 2:
        first, last = frames
        count = min(6, last - first + 1)
        frames = tuple(
            sorted({round(first + k * (last - first) / max(1, count - 1)) for k in range(count)})
        )
    step = max(1.0, len(frames) / MOST)
    return tuple(frames[int(k * step)] for k in range(min(MOST, len(frames))))


def open_evidence(
    event: Event, log: Iterable[Record], video: Path | None, folder: Path
) -> Evidence:
    """Open the evidence of an event's clip.

    Raises:
        InputError: the video is another one.
    """
    if video is None:
        return Evidence(folder, None)
    if not video.is_file():
        raise InputError("is not there", file=video, remedy="name a video that is there")
    digest = sha256_file(video)
    if event.source.sha256 not in (None, digest):
        raise InputError(
            "is not the video that the event was taken from",
            file=video,
            value=digest,
            remedy=f"give the file whose hash is {event.source.sha256}",
        )
    crop: Mapping[str, Any] = {}
    for record in log:
        if record.kind == "source" and record.subject == event.name:
            crop = record.details.get("crop") or {}
    try:
        first_frame, start_s = int(crop.get("first_frame", 0)), float(crop.get("start_s", 0.0))
    except (TypeError, ValueError) as error:
        raise InputError(
            f"the log's crop {crop!r} has no numbers in it",
            remedy="put the log back as it was written",
        ) from error
    return Evidence(folder, video, first_frame, start_s)


class EventUnderReview:
    """One file under review.

    The log is written first: should the machine die between the two, the log knows of a decision
    that the file lacks, and the field is asked about again.

    Args:
        now: time in ISO 8601 UTC.

    Raises:
        InputError: the file is no event.
    """

    def __init__(self, path: Path, log: Path, who: str, now: Callable[[], str]) -> None:
        self.path, self.log, self.who = path, log, who
        self._now = now
        self.event, self.version = load_event(str(path))
        self._file = FileUnderReview(path)

    def record(
        self,
        kind: EntryKind,
        reason: str,
        field: str | None = None,
        old: Any = None,
        new: Any = None,
        **details: Any,
    ) -> Record:
        """Return an entry of L about the event as it stands."""
        return Record(
            kind=kind,
            when=self._now(),
            who=self.who,
            subject=self.event.name,
            version=self.version,
            field=field,
            old=old,
            new=new,
            reason=reason,
            details=details,
        )

    def note(self, record: Record) -> None:
        """Append an entry that changes nothing in the file."""
        append_records(self.log, [record])

    def decide(self, after: Event, records: Iterable[Record]) -> None:
        """Append the entries, then write the event as decided.

        Raises:
            InputError: the file was changed by somebody else meanwhile; nothing is written.
        """
        self._file.check()
        version = event_version(after)
        append_records(
            self.log,
            [
                record.model_copy(update={"details": {**record.details, "version_after": version}})
                for record in records
            ],
        )
        write_text(self.path, event_text(after))
        self.event, self.version = after, version
        self._file.written()


PROMPT = "  [a]ccept [e]dit [u]nresolved [s]kip [r]eject clip [q]uit [?] > "
HELP = """  a  accept the value as it is
  e  give another value, and the reason
  u  leave it unresolved, and say why; a safety-critical field can't stay so in a K*
  s  skip it for now
  r  refuse the whole clip with one of the source gate's reasons
  q  stop here; what was decided is kept, and the same command goes on"""


class End(Enum):
    """The ending of a review."""

    THROUGH = "all fields were shown"
    QUIT = "stopped by the person, or at the end of input"
    REJECTED = "the clip was refused"


def to_decide(event: Event, everything: bool = False) -> list[UndecidedField]:
    """Return the fields that a review goes through: those that a K* needs decided, or all."""
    return [item for item in undecided(event) if everything or item.critical or item.why in _BROKEN]


_BROKEN = ("changed since its review", "origin not stated")


@dataclass
class Session:
    """One review.

    Args:
        stored: where the extraction keeps its frames, None: nowhere.
    """

    reviewed: EventUnderReview
    terminal: Terminal
    evidence: Evidence
    stored: Path | None = None
    _checked: tuple[dict[str, Any], list[Failure]] | None = None

    def run(self, everything: bool = False) -> End:
        """Go through the fields once."""
        items = to_decide(self.reviewed.event, everything)
        self.evidence.prepare(item.frames for item in items)
        version = self.reviewed.version
        waiting = {item.field: item for item in items}
        for number, item in enumerate(items, start=1):
            # An earlier decision may have settled or removed this one.
            if self.reviewed.version != version:
                version = self.reviewed.version
                waiting = {entry.field: entry for entry in undecided(self.reviewed.event)}
            if item.field not in waiting:
                continue
            item = waiting[item.field]
            self._show(item, number, len(items))
            end = self._decide(item)
            if end is not None:
                return end
        return End.THROUGH

    def name_authors(self) -> None:
        """Make the person at the terminal the source of what was changed in an editor.

        A field of a new K* that isn't as its template would else keep the template as its source.
        """
        changed = changed_by_hand(self.reviewed.event)
        if not changed:
            return
        why = "changed in an editor since `ssp spec new`"
        records = [self.reviewed.record("edit", why, c.field, c.old, c.new) for c in changed]
        after = with_author(self.reviewed.event, changed, self.reviewed.who)
        self.reviewed.decide(after, records)
        say = self.terminal.say
        say(f"{len(changed)} fields were {why}; their source is {self.reviewed.who} now:")
        for item in changed:
            say(f"  {item.field}: {value_text(item.new)} (the template has {value_text(item.old)})")
        say("  (if somebody else wrote one, name them as its source in the file)")

    def accept_all(self, reason: str) -> int:
        """Accept every field that isn't safety-critical and waits for nothing but a look."""
        items = [
            item
            for item in undecided(self.reviewed.event)
            if not item.critical and item.why not in _BROKEN
        ]
        event, records = self.reviewed.event, []
        for item in items:
            records.append(
                self.reviewed.record(
                    "accept", reason, item.field, item.value, item.value, together=True
                )
            )
            event = accept(event, item.field)
        if items:
            self.reviewed.decide(event, records)
        return len(items)

    def _show(self, item: UndecidedField, number: int, total: int) -> None:
        kind = "safety-critical, " if item.critical else ""
        say = self.terminal.say
        say(f"\n[{number}/{total}] {item.field} ({kind}{item.why})")
        say(f"  value     {value_text(item.value)}")
        confidence = "" if item.confidence is None else f", confidence {item.confidence:.2f}"
        say(f"  known by  {item.provenance or 'no source'}{confidence}: {item.source or '–'}")
        if item.frames:
            say(f"  frames    {', '.join(map(str, item.frames))}{self._pictures(item.frames)}")
        hint = self._hint(item.field)
        if hint:
            say(f"  may be    {hint}")
        for failure in self._contradictions():
            if within(failure.field, item.field):
                say(_failure_line(failure))

    def _contradictions(self) -> list[Failure]:
        """Check the event as it stands; part U doesn't change the result."""
        value = body(self.reviewed.event)
        if self._checked is None or self._checked[0] != value:
            self._checked = value, contradictions(self.reviewed.event)
        return self._checked[1]

    def _hint(self, path: str) -> str:
        """Describe what may be typed for a field: its words, or a range with units and limits."""
        rule = View(self.reviewed.event).rule(path)
        if rule is None:
            return ", ".join(vocabulary(path))
        units = units_of(rule.dimension)
        shape = "one value, such as 2" if rule.shape == "exact" else "a range such as 2..3"
        others = f" (or in {', '.join(units[1:])})" if len(units) > 1 else ""
        limit = f"{rule.limit.low:g}..{rule.limit.high:g} {units[0]}"
        return f"{shape} {units[0]}{others}, within {limit}"

    def _pictures(self, frames: tuple[int, ...]) -> str:
        sheet = self.evidence.sheet(frames)
        if sheet is not None:
            return f"  see {sheet}"
        if self.stored is not None:
            files = [self.stored / f"{number:06d}.jpg" for number in frames]
            there = [str(file) for file in files if file.is_file()]
            return f"  see {', '.join(there)}" if there else ""
        return ""

    def _decide(self, item: UndecidedField) -> End | None:
        """Ask until there is a decision about one field; return an End when the review is over."""
        acts = {
            "accept": lambda: self._accept(item),
            "edit": lambda: self._edit(item),
            "unresolved": lambda: self._leave(item),
            "skip": lambda: True,
            "reject": lambda: self._reject(item),
        }
        return _ENDS.get(decide(self.terminal, PROMPT, HELP, acts))

    def _accept(self, item: UndecidedField) -> bool:
        if item.critical and is_unresolved(item.value):
            self.terminal.say("  is unresolved and safety-critical: edit it, or skip it")
            return False
        reason = "agrees with the evidence"
        record = self.reviewed.record("accept", reason, item.field, item.value, item.value)
        self.reviewed.decide(accept(self.reviewed.event, item.field), [record])
        return True

    def _edit(self, item: UndecidedField) -> bool:
        text = self.terminal.ask("  new value> ")
        if text is None:
            return False
        try:
            quantity = View(self.reviewed.event).rule(item.field) is not None
            value = read_value(text, item.value, quantity)
            after, changes = edit(self.reviewed.event, item.field, value, self.reviewed.who)
        except Unreadable as error:
            self.terminal.say(f"  not understood: {error}")
            return False
        except NotAllowed as error:
            for failure in error.failures:
                self.terminal.say(_failure_line(failure))
            return False
        reason = ask_reason(self.terminal)
        if reason is None:
            self.terminal.say("  nothing was changed")
            return False
        new = get(body(after), item.field)
        records = [self.reviewed.record("edit", reason, item.field, item.value, new)]
        for change in changes:
            why = f"follows from {item.field}"
            records.append(self.reviewed.record("edit", why, change.field, change.old, change.new))
        before = {failure.field for failure in self._contradictions()}
        self.reviewed.decide(after, records)
        self.terminal.say(f"  is now {value_text(new)}")
        for change in changes:
            self.terminal.say(f"  and with it {change.field}: {value_text(change.new)}")
        failures = self._contradictions()
        for failure in failures:
            mark = "" if failure.field in before else "now: "
            self.terminal.say(_failure_line(failure, mark))
        if not failures:
            self.terminal.say("  no check C1-C5 speaks against the values so far")
        return True

    def _leave(self, item: UndecidedField) -> bool:
        reason = ask_reason(self.terminal)
        if reason is None:
            self.terminal.say("  nothing was changed")
            return False
        after = leave_unresolved(self.reviewed.event, item.field)
        new = get(body(after), item.field)
        record = self.reviewed.record(
            "edit", reason, item.field, item.value, new, review="unresolved"
        )
        self.reviewed.decide(after, [record])
        return True

    def _reject(self, item: UndecidedField) -> bool:
        reasons = list(GATE_REASONS.values())
        for number, reason in enumerate(reasons, start=1):
            self.terminal.say(f"  {number}  {reason}")
        answer = self.terminal.ask("  number of the reason, or nothing to go back> ")
        if answer not in [str(number) for number in range(1, len(reasons) + 1)]:
            self.terminal.say("  the clip is not refused")
            return False
        observation = ask_reason(self.terminal, "  what is to be seen, and where> ")
        if observation is None:
            self.terminal.say("  the clip is not refused")
            return False
        record = self.reviewed.record(
            "gate",
            reasons[int(answer) - 1],
            seen=observation,
            at_field=item.field,
            frames=list(item.frames),
            source_sha256=self.reviewed.event.source.sha256,
        )
        self.reviewed.note(record)
        return True


_ENDS = {QUIT: End.QUIT, "reject": End.REJECTED}


def _failure_line(failure: Failure, mark: str = "") -> str:
    return (
        f"  ! {mark}{failure.check} {failure.field}: {failure.reason} ({failure.evidence}); "
        f"right would be: {failure.remedy}"
    )
