"""The event of a recording by its K* (METHOD 1, 4.1), and the recording's clip."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from ssp_core.errors import InputError
from ssp_core.motion.encounter import Observable
from ssp_core.motion.event import TOLERANCE_S
from ssp_core.run_file.model import ConflictThresholds, RunSpec
from ssp_eval.data.audit import EVENT_PHASES
from ssp_scenario_manager.event_spec.fields import Span, units_of
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.scenarios.events.kinds import KINDS

TurnWord = Literal["left", "right"]
# Intents by which the VUT leaves its road in a junction, and to which side.
TURNS: Mapping[str, TurnWord] = {"turn_left": "left", "turn_right": "right"}
# METHOD 4.1: approach and resolution count as located if so much of each lies in the clip.
LOCATED_S = 0.5
# K*'s times are rounded to milliseconds.
_SHOWN_S = 0.0015


@dataclass(frozen=True, slots=True)
class Window:
    """The stretch of the source before its trigger and after its resolution's start, s.

    Args:
        before_s: a of METHOD 4.1.
        after_s: r of METHOD 4.1; what lasts so long is "for good" (METHOD 1).
        source: whose lengths these are, for people.
    """

    before_s: float
    after_s: float
    source: str


@dataclass(frozen=True, slots=True)
class Crop:
    """The part of a recording that is compared, labelled and scored; times on its clip clock, s.

    Args:
        start_s: first instant.
        end_s: last instant.
        chosen_by: who or what chose it.
        short_before_s: so much of the wanted window lies before the recording's beginning.
        short_after_s: so much of it lies after the recording's end.
    """

    start_s: float
    end_s: float
    chosen_by: str
    short_before_s: float = 0.0
    short_after_s: float = 0.0

    def holds(self, t_s: float) -> bool:
        """Return True for a time inside, ends included."""
        return self.start_s - TOLERANCE_S <= t_s <= self.end_s + TOLERANCE_S

    @property
    def shortfall(self) -> str:
        """Describe by how much the recording is short of the window; empty where it isn't."""
        parts = []
        if self.short_before_s > _SHOWN_S:
            parts.append(f"begins {self.short_before_s:.3f} s late")
        if self.short_after_s > _SHOWN_S:
            parts.append(f"ends {self.short_after_s:.3f} s early")
        return " and ".join(parts)


def crop_of(
    first_s: float,
    last_s: float,
    trigger_s: float | None,
    resolution_s: float | None,
    window: Window | None,
) -> Crop:
    """Return the clip of a recording (METHOD 4.1).

    Args:
        first_s: beginning of the recording.
        last_s: its end.
        trigger_s: start of its trigger; None: the clip is the whole recording.
        resolution_s: start of its resolution; None: the clip ends with the recording.
        window: of the source; None: it is unknown, and the clip is the whole recording.
    """
    if trigger_s is None or window is None:
        why = "without a trigger" if window is not None else "without a source's window"
        return Crop(first_s, last_s, f"the whole recording, {why}")
    start_s = trigger_s - window.before_s
    chosen_by = f"METHOD 4.1 from {window.source}"
    if resolution_s is None:
        end_s = last_s
        chosen_by += ", to the recording's end without a resolution"
    else:
        end_s = resolution_s + window.after_s
    return Crop(
        max(first_s, start_s),
        min(last_s, end_s),
        chosen_by,
        max(0.0, first_s - start_s),
        max(0.0, end_s - last_s),
    )


def source_times(event: Event) -> dict[str, Span]:
    """Return when the source clip starts and ends and its phases start, s of the source.

    Times are left out that are unresolved or open to one side.

    Raises:
        InputError: a time has no unit of time.
    """
    parts = event.events
    quantities = {"start": parts.clip.start, "end": parts.clip.end}
    quantities |= {name: getattr(parts, name).start for name in EVENT_PHASES}
    spans = {}
    for name, quantity in quantities.items():
        if not isinstance(quantity, str) and None not in (quantity.min, quantity.max):
            spans[name] = _span(quantity)
    return spans


def phase_starts(event: Event) -> dict[str, float]:
    """Return the phases' starts in the source's clip time, s; an interval counts as its middle."""
    at = source_times(event)
    if "start" not in at:
        return {}
    return {name: at[name].mid - at["start"].mid for name in EVENT_PHASES if name in at}


def _span(interval: Interval) -> Span:
    if interval.unit not in units_of("time"):
        raise InputError(
            "is no unit of time",
            field="unit",
            value=interval.unit,
            remedy=f"{' or '.join(units_of('time'))}; `ssp spec check` says where it stands",
        )
    return interval.si


@dataclass(frozen=True)
class EventRules:
    """The rules for the begin of an event's phases, and for its clip (METHOD 1, 4.1).

    Args:
        thresholds: of the conflict, s; an interval of K* counts with its middle.
        observable: what makes the manoeuvre observable; None: it isn't stated.
        window: of the source's crop; None: it is unknown.
        origin: whose rules these are, for people.
        vut_turn: the side to which the VUT means to turn at a junction; None: it doesn't.
    """

    thresholds: ConflictThresholds
    observable: Observable | None
    window: Window | None
    origin: str
    vut_turn: TurnWord | None = None

    @property
    def for_good_s(self) -> float | None:
        """Return the duration that is for good; None: to the recording's end."""
        return None if self.window is None else self.window.after_s


NO_RULES = EventRules(ConflictThresholds(), None, None, "no K*, the defaults")


def rules_of(event: Event | None, run: RunSpec | None = None) -> EventRules:
    """Return the rules of a K*, else those of the run, else none.

    Raises:
        InputError: a time or a threshold of the K* has no unit of time.
    """
    if event is None:
        if run is None:
            return NO_RULES
        return EventRules(run.thresholds, run.observable, None, "the recorded run")
    limits = event.constraints.thresholds
    kind = KINDS.get(event.interaction.type)
    observable = None if run is None else run.observable
    at, window = source_times(event), None
    if {"start", "end", "trigger", "resolution"} <= set(at):
        window = Window(
            at["trigger"].mid - at["start"].mid,
            at["end"].mid - at["resolution"].mid,
            f"K* {event.name}",
        )
    return EventRules(
        ConflictThresholds(ttc_s=_middle(limits.ttc), arrival_gap_s=_middle(limits.arrival_gap)),
        observable if kind is None else kind.observable,
        window,
        f"K* {event.name}",
        TURNS.get(str(event.participants[event.vut_id].intent)),
    )


def _middle(interval: Interval | None) -> float | None:
    if interval is None or (interval.min is None and interval.max is None):
        return None
    return _span(interval).mid
