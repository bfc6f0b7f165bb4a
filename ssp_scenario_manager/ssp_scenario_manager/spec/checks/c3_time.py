"""C3, part E: approach < trigger < conflict < resolution, and the evidence for it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.spec.checks.base import Fail, Predicate, View
from ssp_scenario_manager.spec.failure import Failure
from ssp_scenario_manager.spec.model import Evidence
from ssp_scenario_manager.spec.units import Span

_fail = Fail("C3")

# Of approach and resolution, for a phase to count as located (METHOD 4.1).
LEAST_S = 0.5
_EPS_S = 1e-6
# Times are written to milliseconds.
_ROUNDING_S = 0.001


def phases_in_order(view: View) -> Iterator[Failure]:
    """Each phase starts after the one before it."""
    for before, after in pairwise(PHASES):
        paths = [f"events.{phase}.start" for phase in (after, before)]
        late, early = view.span(paths[0]), view.span(paths[1])
        if late is None or early is None:
            continue
        if not (early.high <= late.low + _EPS_S and early.low < late.high - _EPS_S):
            yield _fail(
                paths[0],
                view.said(*paths),
                f"{after} doesn't start after {before}",
                f"{after} later than {before}; intervals may touch, not overlap",
            )


def phases_inside_the_clip(view: View) -> Iterator[Failure]:
    """The approach starts with the clip, and the resolution before its end."""
    start, end = view.span("events.clip.start"), view.span("events.clip.end")
    first, last = view.span("events.approach.start"), view.span("events.resolution.start")
    if start and end and not start.high < end.low:
        yield _fail(
            "events.clip.end",
            view.said("events.clip.end", "events.clip.start"),
            "the clip ends before it starts",
            "an end after the start",
        )
    if start and first and (abs(first.low - start.low) > _EPS_S or first.high != first.low):
        yield _fail(
            "events.approach.start",
            view.said("events.approach.start", "events.clip.start"),
            "the approach is all that comes before the trigger: it starts with the clip",
            "the clip's start",
        )
    if end and last and not last.high < end.low - _EPS_S:
        yield _fail(
            "events.resolution.start",
            view.said("events.resolution.start", "events.clip.end"),
            "nothing of the resolution is in the clip",
            "a start before the clip's end",
        )


def enough_before_and_after(view: View) -> Iterator[Failure]:
    """The crop holds at least 0.5 s of approach and of resolution (METHOD 4.1)."""
    for phase, first, last in (
        ("approach", "events.clip.start", "events.trigger.start"),
        ("resolution", "events.resolution.start", "events.clip.end"),
    ):
        early, late = view.span(first), view.span(last)
        if early is None or late is None or late.mid - early.mid >= LEAST_S - _EPS_S:
            continue
        yield _fail(
            last,
            view.said(last, first),
            f"the crop shows {late.mid - early.mid:.3f} s of the {phase}, and no recording cropped "
            "like it can be compared",
            f"at least {LEAST_S:g} s of it in the crop",
        )


def evidence_is_readable(view: View) -> Iterator[Failure]:
    """Evidence names frames or a span, in order, and both say the same at the source's rate."""
    rate = _rate(view)
    for phase in PHASES:
        listed = getattr(view.event.events, phase).evidence
        if any(evidence in listed[:i] for i, evidence in enumerate(listed)):
            path = f"events.{phase}.evidence"
            yield _fail(path, view.said(path), "an entry stands twice", "each entry once")
    for path, evidence in _evidence(view):
        if evidence.frames is None and evidence.span_s is None:
            yield _fail(
                path,
                view.said(path),
                "says nothing",
                "frames or span_s",
                "open decision",
            )
        for name in ("frames", "span_s"):
            ends = getattr(evidence, name)
            if ends is not None and ends[0] > ends[1]:
                yield _fail(
                    f"{path}.{name}",
                    view.said(f"{path}.{name}"),
                    "ends before it starts",
                    "the earlier end first",
                    view.origin(path),
                )
        if rate is None or evidence.frames is None or evidence.span_s is None:
            continue
        for i in (0, 1):
            at_s, frame = evidence.frames[i] / rate.low, evidence.span_s[i] * rate.low
            if abs(at_s - evidence.span_s[i]) > 0.5 / rate.low:
                yield _fail(
                    f"{path}.frames[{i}]",
                    view.said(f"{path}.frames[{i}]", f"{path}.span_s[{i}]", "source.rate"),
                    f"this frame is at {at_s:.3f} s",
                    f"frame {frame:.0f} or {at_s:.3f} s",
                    view.origin(path),
                )


def evidence_shows_its_phase(view: View) -> Iterator[Failure]:
    """A phase has started when it is first seen, and lasts while it is seen."""
    rate = _rate(view)
    frame_s = 1.0 / rate.low if rate else 0.0
    end = view.span("events.clip.end")
    for i, phase in enumerate(PHASES):
        path = f"events.{phase}"
        start = view.span(f"{path}.start")
        after = f"events.{PHASES[i + 1]}.start" if i + 1 < len(PHASES) else "events.clip.end"
        until = view.span(after) or end
        found = [
            (f"{path}.evidence[{k}]", span)
            for k, evidence in enumerate(getattr(view.event.events, phase).evidence)
            if (span := _span_s(evidence, rate)) is not None
        ]
        if start is None or not found:
            continue
        slack = frame_s / 2 + _ROUNDING_S
        first_path, first = min(found, key=lambda item: item[1].low)
        if abs(first.low - start.high) > slack:
            yield _fail(
                first_path,
                view.said(first_path, f"{path}.start"),
                f"{phase} has started when it is first seen, and not later",
                f"evidence from {start.high:g} s on, or a start up to {first.low:g} s",
                view.origin(first_path),
            )
        for at, span in found:
            if until is not None and span.high > until.low + slack:
                yield _fail(
                    at,
                    view.said(at, after),
                    f"the evidence for {phase} goes on when it may be over",
                    f"evidence up to {until.low:g} s, or a later end of {phase}",
                    view.origin(at),
                )


def _rate(view: View) -> Span | None:
    """Frames a second of the source, if they are known."""
    rate = view.span("source.rate")
    return rate if rate and rate.low == rate.high else None


def _evidence(view: View) -> Iterator[tuple[str, Evidence]]:
    for phase in PHASES:
        for i, evidence in enumerate(getattr(view.event.events, phase).evidence):
            yield f"events.{phase}.evidence[{i}]", evidence


def _span_s(evidence: Evidence, rate: Span | None) -> Span | None:
    """When something can be seen, from its span or, with the source's rate, from its frames."""
    if evidence.span_s is not None:
        return Span(*evidence.span_s)
    if evidence.frames is not None and rate is not None:
        return Span(evidence.frames[0] / rate.low, evidence.frames[1] / rate.low)
    return None


PREDICATES: tuple[Predicate, ...] = (
    phases_in_order,
    phases_inside_the_clip,
    enough_before_and_after,
    evidence_is_readable,
    evidence_shows_its_phase,
)
