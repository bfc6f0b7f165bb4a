"""The conversion of a session's messages to the page's plain values."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any, TypeVar

from ssp_core.cdr.codec import decoder, read_header, read_text
from ssp_core.cdr.images import COMPRESSED_TYPE, JPEG_START, read_image
from ssp_core.cdr.messages import stamp_ns
from ssp_core.cdr.references import Acknowledgement
from ssp_core.safety.body_status import BodyStatus
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.publishers import MOST_TOLD
from ssp_core.vocabulary import Phase, SessionPhase, Verdict
from ssp_monitor.status.board import Answer, Event, LinkFact, RecorderFact, SessionFact, TopicFact

# What people read; anybody may send more, and a page shows it ten times a second.
_MOST_TEXT = 2000
Fact = TypeVar("Fact", SessionFact, RecorderFact, TopicFact)


def _short(text: str) -> str:
    return text if len(text) <= _MOST_TEXT else f"{text[:_MOST_TEXT]}…"


def _read(kind: type[Fact], message: Any, **known: Any) -> Fact:
    """Read a message under the names that the fact has, its texts shortened.

    Args:
        kind: of the fact.
        message: decoded.
        known: fields that are not read by their names.
    """
    for name in (field.name for field in fields(kind) if field.name not in known):
        value = getattr(message, name)
        if isinstance(value, str):
            value = _short(value)
        elif isinstance(value, list):
            value = tuple(map(_short, value))
        known[name] = value
    return kind(**known)


def session_fact(message: Any) -> SessionFact:
    """Read a SessionState. Raise ValueError for an unknown state or verdict."""
    return _read(
        SessionFact,
        message,
        stamp_ns=stamp_ns(message.header.stamp),
        state=SessionPhase(message.state),
        verdict=Verdict(message.verdict),
    )


def phase_of(message: Any) -> tuple[Phase, Event]:
    """Read a PhaseEvent. Raise ValueError for an unknown phase."""
    phase = Phase(message.phase)
    title = f"phase {phase.name.lower()}" + (", provisional" if message.provisional else "")
    return phase, Event("phase", stamp_ns(message.header.stamp), title, _short(message.evidence))


def safety_event(message: Any) -> Event:
    """Read a SafetyEvent; an operator's act, or an event in words alone, has no measure."""
    in_words = message.code == SafetyCode.OPERATOR or bool(message.words)
    source_text = f"seen by {message.source}, {message.reaction.replace('_', ' ')}"
    return Event(
        "safety",
        stamp_ns(message.header.stamp),
        _short(message.limit_name.replace("_", " ")),
        _short(f"{message.words}; {source_text}" if message.words else source_text),
        _short(message.object_id),
        math.nan if in_words else message.measured,
        math.nan if in_words else message.limit,
        _short(message.unit),
    )


def trigger_event(message: Any) -> Event:
    """Read a TriggerEvent; its measure is the condition's value at the later of its two samples."""
    values = list(message.sample_values)
    sent = f"reference {', '.join(message.reference_ids)} sent to {', '.join(message.object_ids)}"
    if not message.reference_ids:
        sent = "nothing to send, judged"
    return Event(
        "trigger",
        stamp_ns(message.crossing_time),
        _short(f"trigger {message.trigger_id}"),
        _short(f"{message.condition}; {sent}, {message.processing * 1e3:.1f} ms later"),
        measured=values[-1] if values else math.nan,
        limit=message.threshold,
    )


def fault_event(message: Any) -> Event:
    """Read a FaultEvent, something that was injected on purpose."""
    what = message.fault.partition(" ")[2].replace("_", " ") or message.fault
    return Event(
        "fault",
        stamp_ns(message.header.stamp),
        _short(f"fault {what} {'begins' if message.active else 'ends'}"),
        _short(f"injected by {message.source}"),
        _short(message.target),
        message.value,
        unit=_short(message.unit),
    )


def refused_event(ack: Acknowledgement) -> Event:
    """Make an event of an object's refusal of a reference."""
    return Event(
        "refused",
        ack.stamp_ns,
        f"reference {ack.reference_id} refused",
        ack.error_msg,
        ack.object_id,
    )


def link_facts(message: Any) -> dict[str, LinkFact]:
    """Read a LinkStatus, by object; lists of unequal lengths give what all of them have."""
    columns = zip(
        message.object_ids,
        message.clock_offset,
        message.delay,
        message.state_age,
        message.states_received,
        message.states_lost,
        strict=False,
    )
    return {
        name: LinkFact(float(offset), float(delay), float(age), int(received), int(lost))
        for name, offset, delay, age, received, lost in columns
    }


def strangers_of(message: Any) -> tuple[str, ...]:
    """Read the strangers of a LinkStatus, as sentences."""
    return tuple(map(_short, message.strangers[:MOST_TOLD]))


def recorder_fact(message: Any) -> RecorderFact:
    """Read a RecorderStatus."""
    return _read(
        RecorderFact,
        message,
        missing=tuple(map(_short, message.missing_topics)),
        topics=tuple(_read(TopicFact, topic) for topic in message.topics),
    )


def localisation(message: Any) -> str:
    """Return why a LocalisationStatus says that no state is made."""
    return _short(message.reason)


def body_status(message: Any) -> BodyStatus:
    """Read a BodyStatus."""
    return BodyStatus(
        _short(message.object_id),
        tuple(map(_short, message.no_state)),
        tuple(map(_short, message.cannot_arm)),
        message.lasting,
    )


def command_answer(response: Any) -> Answer:
    """Read the manager's answer to a command."""
    try:
        state = SessionPhase(response.session_state).name
    except ValueError:
        state = ""
    return Answer(bool(response.accepted), response.error_msg, tuple(response.missing), True, state)


def jpeg_of(data: bytes) -> bytes:
    """Return the picture in a serialised CompressedImage as it is; ValueError if not JPEG."""
    image = read_image(COMPRESSED_TYPE, data)
    if image.data[:2] != JPEG_START:
        raise ValueError(f"a picture of format {image.format[:20]!r} is no JPEG")
    return bytes(image.data)


@decoder
def source_of(data: bytes, at: int) -> tuple[str, int]:
    """Read the sender of a serialised ObjectStates; the states are passed over."""
    _, at = read_header(data, at)
    return read_text(data, at)[0], len(data)
