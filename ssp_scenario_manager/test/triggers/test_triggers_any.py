"""Triggers on any sequence of states, against a slow second opinion.

The second opinion judges straight from the definition, from the whole history at every state. It
shares no code with the product: values by its own formulas on a straight road, in fractions; truth
as a function of half nanoseconds that is looked up wherever anything may change; no memory between
two questions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.participants import TriggerSpec
from ssp_core.vocabulary import Phase
from ssp_scenario_manager.triggers.conditions import Snapshot
from ssp_scenario_manager.triggers.evaluator import TriggerWatch
from tests.support.states import object_state

NEVER = float("inf")
FRONT, REAR, WIDTH = Fraction(7, 2), Fraction(1), Fraction(2)
AGE_NS = 250_000_000


@dataclass(frozen=True)
class Body:
    """State of a car on the x axis, or in parallel to it; x or speed None: not finite."""

    stamp_ns: int
    x: Fraction | None
    y: Fraction
    speed: Fraction | None


@dataclass(frozen=True)
class Arrival:
    """A VUT state arrives; what is known then of the objects and phases."""

    vut: Body
    others: dict[str, Body]
    phases: dict[str, int]


Value = float | None  # None: unknown


def _at(body: Body | None, stamp_ns: int) -> tuple[Fraction, Fraction, Fraction] | None:
    """x, y and speed at a stamp."""
    if body is None or body.x is None or body.speed is None:
        return None
    if abs(stamp_ns - body.stamp_ns) > AGE_NS:
        return None
    dt = Fraction(stamp_ns - body.stamp_ns, 1_000_000_000)
    return body.x + body.speed * dt, body.y, body.speed


def value(leaf: dict[str, Any], arrival: Arrival) -> Value:
    """A measured condition's value."""
    now = arrival.vut.stamp_ns
    vut = _at(arrival.vut, now)
    kind, name = leaf["type"], leaf.get("object_id")
    who = vut if name == "vut" else _at(arrival.others.get(name or ""), now)
    if kind == "speed":
        return None if who is None else float(who[2])
    if kind == "in_region":
        if who is None:
            return None
        (x0, y0), _, (x1, y1), _ = leaf["polygon"]
        x, y, _ = who
        # Objects are always between the lower and the upper edge.
        return float(min(x - Fraction(x0), Fraction(x1) - x, y - Fraction(y0), Fraction(y1) - y))
    if vut is None:
        return None
    front = vut[0] + FRONT
    if kind == "time_to_arrival":
        way = Fraction(leaf["anchor"][0]) - front
        return NEVER if way < 0 or float(vut[2]) < 0.1 else float(way / vut[2])
    if who is None:
        return None
    gap = who[0] - REAR - front
    if gap < 0:
        return NEVER
    if kind == "relative_distance":
        return float(gap)
    if kind == "time_headway":
        return NEVER if float(vut[2]) < 0.1 else float(gap / vut[2])
    assert kind == "time_to_collision"
    closing = vut[2] - who[2]
    in_corridor = abs(who[1]) - WIDTH / 2 <= WIDTH / 2 + Fraction(3, 10)
    return float(gap / closing) if in_corridor and float(closing) > 0.05 else NEVER


def _compares(leaf: dict[str, Any], number: Value) -> bool | None:
    if number is None:
        return None
    if leaf["type"] == "speed":
        above = leaf["relation"] == "above"
        return number > leaf["value_mps"] if above else number < leaf["value_mps"]
    if leaf["type"] == "in_region":
        return number > 0.0
    return number < _threshold(leaf)


def _threshold(leaf: dict[str, Any]) -> float:
    return float(leaf.get("below_m") or leaf.get("below_s") or leaf.get("value_mps") or 0.0)


def _half_ns(before: tuple[int, Value], now: tuple[int, Value], threshold: float) -> int:
    """Return when a measured condition changes between two samples, in half nanoseconds."""
    (t0, v0), (t1, v1) = before, now
    instant = t1
    if v0 is not None and v1 is not None and NEVER not in (v0, v1):
        rise = Fraction(v1) - Fraction(v0)
        instant = round(t0 + (Fraction(threshold) - Fraction(v0)) / rise * (t1 - t0))
    return 2 * instant + 1 if instant == t0 else 2 * instant


class Signal:
    """Truth of one single condition as a function of half nanoseconds."""

    def __init__(
        self, leaf: dict[str, Any], history: list[Arrival], start_ns: int, phases: dict[str, int]
    ) -> None:
        self.from_half: int | None = None
        self.stretches: list[tuple[int, bool | None]] = []
        if leaf["type"] == "elapsed_time":
            self.from_half = 2 * (start_ns + round(leaf["after_s"] * 1_000_000_000))
        elif leaf["type"] == "phase_reached":
            self.from_half = 2 * phases.get(leaf["phase"], 1 << 80)
        else:
            samples = [(a.vut.stamp_ns, value(leaf, a)) for a in history]
            for i, now in enumerate(samples):
                holds = _compares(leaf, now[1])
                if i == 0:
                    self.stretches.append((2 * now[0], holds))
                elif holds is not self.stretches[-1][1]:
                    half = _half_ns(samples[i - 1], now, _threshold(leaf))
                    self.stretches.append((half, holds))

    def at(self, half: int) -> bool | None:
        if self.from_half is not None:
            return half >= self.from_half
        return [holds for begin, holds in self.stretches if begin <= half][-1]

    def changes(self) -> list[int]:
        return [h for h, _ in self.stretches] + ([self.from_half] if self.from_half else [])


def _whole(condition: dict[str, Any], signals: list[Signal], half: int) -> bool | None:
    """Minimum and maximum of 0, 1/2 and 1."""

    def grade(part: dict[str, Any]) -> float:
        if part["type"] == "all":
            return min([grade(p) for p in part["of"]])
        if part["type"] == "any":
            return max([grade(p) for p in part["of"]])
        holds = leaves.pop(0).at(half)
        return 0.5 if holds is None else float(holds)

    leaves = list(signals)
    return {0.0: False, 0.5: None, 1.0: True}[grade(condition)]


def singles(condition: dict[str, Any]) -> list[dict[str, Any]]:
    if condition["type"] in ("all", "any"):
        return [leaf for part in condition["of"] for leaf in singles(part)]
    return [condition]


def newer_arrivals(arrivals: list[Arrival]) -> list[Arrival]:
    """Those that are newer than all before."""
    return [
        a
        for i, a in enumerate(arrivals)
        if all(b.vut.stamp_ns < a.vut.stamp_ns for b in arrivals[:i])
    ]


def fires(
    condition: dict[str, Any],
    edge: str,
    held_ns: int,
    not_before_ns: int,
    start_ns: int,
    arrivals: list[Arrival],
) -> tuple[int, int] | None:
    """(Crossing, stamp) of the only firing, None: there is none."""
    counted = [a for a in newer_arrivals(arrivals) if a.vut.stamp_ns >= start_ns + not_before_ns]
    for n in range(1, len(counted) + 1):
        history = counted[:n]
        begin, end = 2 * history[0].vut.stamp_ns, 2 * history[-1].vut.stamp_ns
        signals = [Signal(s, history, start_ns, history[-1].phases) for s in singles(condition)]
        places = {begin, end, *(c for s in signals for c in s.changes() if begin <= c <= end)}
        course = [(h, _whole(condition, signals, h)) for h in sorted(places)]
        wanted = edge != "falling"
        if course[-1][1] is not wanted:
            continue
        run = len(course) - 1
        while run > 0 and course[run - 1][1] is wanted:
            run -= 1
        since = course[run][0] // 2
        if end // 2 - since < held_ns:
            continue
        if edge != "none" and all(holds is not (not wanted) for _, holds in course):
            continue
        return since, end // 2
    return None


# -- sequences ------------------------------------------------------------------------------------

# A 512th of a second: with it, every number below is exact in binary, and the second opinion may
# be compared to the last nanosecond.
TICK_NS = 1_953_125
PATH = Polyline([(0.0, 0.0), (256.0, 0.0)])
SIZE = Size(float(FRONT), float(REAR), float(WIDTH), 1.5)
NAMES = ("ot1", "ot2")
SQUARE = [(64.0, -8.0), (96.0, -8.0), (96.0, 8.0), (64.0, 8.0)]


def _leaf() -> st.SearchStrategy[dict[str, Any]]:
    name = st.sampled_from(NAMES)
    anyone = st.sampled_from(("vut", *NAMES))
    metres = st.integers(2, 12).map(lambda n: n * 2.0)
    seconds = st.sampled_from([0.5, 1.0, 1.5, 2.0, 4.0, 8.0])
    return st.one_of(
        st.fixed_dictionaries(
            {"type": st.just("relative_distance"), "object_id": name, "below_m": metres}
        ),
        st.fixed_dictionaries(
            {
                "type": st.sampled_from(["time_headway", "time_to_collision"]),
                "object_id": name,
                "below_s": seconds,
            }
        ),
        st.fixed_dictionaries(
            {
                "type": st.just("time_to_arrival"),
                "anchor": st.just((96.0, 0.0)),
                "below_s": seconds,
            }
        ),
        st.fixed_dictionaries(
            {
                "type": st.just("speed"),
                "object_id": anyone,
                "relation": st.sampled_from(["above", "below"]),
                "value_mps": st.sampled_from([2.0, 4.0, 6.0, 8.0]),
            }
        ),
        st.fixed_dictionaries(
            {"type": st.just("in_region"), "object_id": anyone, "polygon": st.just(SQUARE)}
        ),
        st.fixed_dictionaries(
            {
                "type": st.just("phase_reached"),
                "phase": st.sampled_from(["trigger", "conflict", "resolution"]),
            }
        ),
        st.fixed_dictionaries(
            {
                "type": st.just("elapsed_time"),
                "after_s": st.integers(0, 20).map(lambda n: 5 * n / 512),
            }
        ),
    )


def _nested(part: st.SearchStrategy[dict[str, Any]]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries(
        {"type": st.sampled_from(["all", "any"]), "of": st.lists(part, min_size=1, max_size=3)}
    )


CONDITIONS = st.one_of(_leaf(), _nested(_leaf()), _nested(st.one_of(_leaf(), _nested(_leaf()))))


@st.composite
def sequences(draw: st.DrawFn) -> list[Arrival]:
    """VUT states in order of arrival, with all that is known of the others by then.

    Steps of 0 to 150 ms, some back; speeds that change at once, positions that follow them with
    noise; objects that are heard seldom, late, early or with NaN; phases confirmed long after.
    """
    number = st.integers
    arrivals: list[Arrival] = []
    stamps = [500]
    x, speed = Fraction(40), Fraction(8)
    others: dict[str, Body] = {}
    phases: dict[str, int] = {}
    lanes = {name: Fraction(draw(st.sampled_from([0, 4]))) for name in NAMES}
    places = {name: Fraction(draw(number(50, 90))) for name in NAMES}
    for _ in range(draw(number(1, 14))):
        step = draw(st.sampled_from([5, 5, 10, 10, 20, 40, 75, 200, 0, -5, -10, -30]))
        stamps.append(max(stamps[-1] + step, 500))
        stamp = stamps[-1]
        if draw(number(0, 2)) == 0:
            speed = Fraction(draw(number(0, 6)) * 2)
        x += draw(st.sampled_from([0, 0, 1, 1, 2, 4, 8, -1, Fraction(1, 8)]))
        lost = draw(number(0, 19)) == 0
        vut = Body(stamp * TICK_NS, None if lost else x, Fraction(0), speed)
        for name in NAMES:
            if draw(number(0, 2)):
                places[name] += draw(st.sampled_from([0, 0, 1, 2, 4, -1, -3, Fraction(3, 8)]))
                late = draw(st.sampled_from([0, 0, 0, 5, 20, -10, 127, 128, 129, -128, -129]))
                odd = draw(number(0, 19)) == 0
                others[name] = Body(
                    (stamp - late) * TICK_NS,
                    places[name],
                    lanes[name],
                    None if odd else Fraction(draw(number(0, 4)) * 2),
                )
        if draw(number(0, 3)) == 0 and len(phases) < 3:
            word = ("trigger", "conflict", "resolution")[len(phases)]
            begun = draw(st.one_of(st.sampled_from(stamps), number(480, stamp)))
            phases[word] = begun * TICK_NS
        arrivals.append(Arrival(vut, dict(others), dict(phases)))
    return arrivals


def _state(name: str, body: Body) -> ObjectState:
    x = math.nan if body.x is None else float(body.x)
    speed = math.nan if body.speed is None else float(body.speed)
    placed = {"x_m": x, "y_m": float(body.y), "speed_mps": speed, "size": SIZE}
    return object_state(name, stamp_ns=body.stamp_ns, **placed)


def _snapshot(arrival: Arrival) -> Snapshot:
    targets = {name: _state(name, body) for name, body in arrival.others.items()}
    phases = {Phase[word.upper()]: ns for word, ns in arrival.phases.items()}
    return Snapshot(_state("vut", arrival.vut), targets, PATH, AGE_NS, phases)


@settings(max_examples=400, deadline=None)
@given(
    arrivals=sequences(),
    condition=CONDITIONS,
    edge=st.sampled_from(["none", "rising", "falling"]),
    held=st.sampled_from([0, 0, 0, 5, 10, 40, 200]),
    not_before=st.sampled_from([0, 0, 5, 15, 60]),
    start=st.sampled_from([500, 505, 540]),
)
def test_any_sequence_fires_as_the_definition_says(
    arrivals: list[Arrival],
    condition: dict[str, Any],
    edge: str,
    held: int,
    not_before: int,
    start: int,
) -> None:
    asked = TriggerSpec.model_validate(
        {
            "id": "t",
            "condition": condition,
            "edge": edge,
            "held_for_s": held / 512,
            "not_before_s": not_before / 512,
            "object_id": "ot1",
            "manoeuvre": {"kind": "brake", "to_mps": 0.0, "deceleration_mps2": 1.0},
        }
    )
    watch = TriggerWatch(asked, PATH, start * TICK_NS)
    firings = [f for f in [watch.observe(_snapshot(a)) for a in arrivals] if f is not None]
    expected = fires(
        condition, edge, held * TICK_NS, not_before * TICK_NS, start * TICK_NS, arrivals
    )
    found = [(firing.crossing_ns, firing.fired_ns) for firing in firings]
    assert found == ([] if expected is None else [expected])
    for firing in firings:
        assert firing.crossing_ns <= firing.fired_ns
        assert firing.samples[-1].stamp_ns <= firing.fired_ns
