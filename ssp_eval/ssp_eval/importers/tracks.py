"""The motion of one object as a source gives it, checked and completed (METHOD 4.3).

Whatever recorded it, a track ends as the states of an object's reference point in frame map:
positions, headings and speeds that agree with each other, on one clock.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.geometry import FloatArray, wrap_angle
from ssp_core.motion.encounter import OBSERVABLE_LATERAL_MPS
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState, Size
from ssp_core.vocabulary import ObjectClass, Role
from ssp_eval.recordings.states import STATE_AGE_S

# Derivatives are the slope of a straight line through the samples this near in time, at least
# three of them.
SLOPE_HALF_S = 0.15
# A slope needs as many.
LEAST_SAMPLES = 3
# Between two states an object moves by its speed; more than this beyond it is a jump.
JUMP_M = 1.5
# Reported speed over distance covered: further from 1 than this is another unit or another motion.
SPEED_RATIO = 1.25
# Heading against direction of motion; people may walk sideways, vehicles don't.
HEADING_RAD = math.radians(20.0)
WALKER_HEADING_RAD = math.radians(60.0)
# Slower than this, the direction of motion says nothing.
MOVING_MPS = 1.0
_LEAST_WAY_M = 2.0
_SIDEWAYS_HALF_S = 0.5
_NS = NDArray[np.int64]

ReferencePoint = Literal["rear_axle", "centre", "front", "rear"]


@dataclass(frozen=True)
class Source:
    """Where a track stands, for errors.

    Args:
        file: table or bag.
        field: topic, or id in the table.
        lines: of the table, one a sample; None: the source has no lines.
    """

    file: Path
    field: str
    lines: Sequence[int] | None = None

    def error(
        self, problem: str, remedy: str, *, index: int | None = None, value: object = None,
        field: str | None = None,
    ) -> InputError:  # fmt: skip
        line = None if self.lines is None or index is None else self.lines[index]
        return InputError(
            problem, file=self.file, line=line, field=field or self.field, value=value,
            remedy=remedy,
        )  # fmt: skip


@dataclass(frozen=True)
class Samples:
    """What a source says of one object, one entry a sample, in the order of the source.

    Args:
        stamps_ns: on the source's clock.
        x_m: of the point that is reported.
        y_m: as x_m.
        yaw_rad: counter-clockwise from +x; None: the source has no headings.
        speed_mps: along the heading, backwards is negative; None: the source has none.
        yaw_rate_radps: None: the source has none.
        acceleration_mps2: along the heading; None: the source has none.
        source: where they stand.
    """

    stamps_ns: _NS
    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray | None
    speed_mps: FloatArray | None
    yaw_rate_radps: FloatArray | None
    acceleration_mps2: FloatArray | None
    source: Source

    def taken(self, keep: NDArray[np.bool_] | _NS) -> Samples:
        """These samples alone."""
        lines = self.source.lines
        kept = None if lines is None else tuple(np.asarray(lines)[keep].tolist())

        def of(values: FloatArray | None) -> FloatArray | None:
            return None if values is None else values[keep]

        return Samples(
            self.stamps_ns[keep], self.x_m[keep], self.y_m[keep], of(self.yaw_rad),
            of(self.speed_mps), of(self.yaw_rate_radps), of(self.acceleration_mps2),
            replace(self.source, lines=kept),
        )  # fmt: skip


@dataclass(frozen=True)
class Rigid:
    """A rigid motion in the plane: turned by yaw about the origin, then moved."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0

    def applied(self, samples: Samples) -> Samples:
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return replace(
            samples,
            x_m=c * samples.x_m - s * samples.y_m + self.x_m,
            y_m=s * samples.x_m + c * samples.y_m + self.y_m,
            yaw_rad=None if samples.yaw_rad is None else samples.yaw_rad + self.yaw_rad,
        )


@dataclass(frozen=True)
class Body:
    """What is said of an object beside its motion.

    Args:
        object_id: in the recording that is made.
        object_class: word of METHOD 5.1.
        role: in the event.
        size: None: the typical one of its class.
        reference: which point of it the source reports; a number: m ahead of the rear axle.
        heading_from_motion: the heading is the direction of motion, whatever the source says.
        transform: from the source's frame to that of the recording.
    """

    object_id: str
    object_class: ObjectClass
    role: Role
    size: Size | None
    reference: ReferencePoint | float
    heading_from_motion: bool = False
    transform: Rigid = Rigid()

    @property
    def extent(self) -> Size:
        return DEFAULT_SIZES[self.object_class] if self.size is None else self.size

    @property
    def ahead_m(self) -> float:
        """How far the reported point lies ahead of the reference point of ObjectState.msg."""
        size = self.extent
        match self.reference:
            case "rear_axle":
                return 0.0
            case "centre":
                return (size.front_m - size.rear_m) / 2.0
            case "front":
                return size.front_m
            case "rear":
                return -size.rear_m
            case metres:
                return metres


def size_of(object_class: ObjectClass, length_m: float, width_m: float, height_m: float) -> Size:
    """The extent of an object of these outer measures.

    The reference point divides its length as it divides that of the typical object of its class.
    """
    typical = DEFAULT_SIZES[object_class]
    front_m = length_m * typical.front_m / typical.length_m
    return Size(front_m, length_m - front_m, width_m, height_m)


@dataclass(frozen=True)
class Track:
    """The states of one object's reference point in frame map, stamps rising.

    Args:
        body: whose.
        samples: with heading, speed, yaw rate and acceleration.
        notes: what was derived, dropped or noticed, for people.
    """

    body: Body
    samples: Samples
    notes: tuple[str, ...]

    @property
    def first_ns(self) -> int:
        return int(self.samples.stamps_ns[0])

    @property
    def last_ns(self) -> int:
        return int(self.samples.stamps_ns[-1])

    def states(self, zero_ns: int = 0) -> Iterator[ObjectState]:
        """The states, numbered from 1.

        Args:
            zero_ns: is taken from every stamp.
        """
        body, s = self.body, self.samples
        yaw, speed, rate, acceleration = _complete(s)
        for i, stamp_ns in enumerate(s.stamps_ns.tolist()):
            yield ObjectState(
                object_id=body.object_id,
                object_class=body.object_class,
                role=body.role,
                stamp_ns=stamp_ns - zero_ns,
                x_m=float(s.x_m[i]),
                y_m=float(s.y_m[i]),
                yaw_rad=wrap_angle(float(yaw[i])),
                speed_mps=float(speed[i]),
                acceleration_mps2=float(acceleration[i]),
                yaw_rate_radps=float(rate[i]),
                size=body.extent,
                sequence=i + 1,
            )


def _complete(s: Samples) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    parts = (s.yaw_rad, s.speed_mps, s.yaw_rate_radps, s.acceleration_mps2)
    found = [part for part in parts if part is not None]
    if len(found) < len(parts):
        raise ValueError("a track has heading, speed, yaw rate and acceleration")
    return found[0], found[1], found[2], found[3]


def slopes(t_s: FloatArray, values: FloatArray, half_s: float = SLOPE_HALF_S) -> FloatArray:
    """Derivative of each column by a straight line through the samples near in time.

    Args:
        t_s: shape (n,), rising.
        values: shape (n, k).
        half_s: samples up to this far away count; always at least three.

    Returns:
        Shape (n, k), per second; zeros for less than two samples.
    """
    n = len(t_s)
    found = np.zeros_like(values)
    if n < 2:
        return found
    low = np.searchsorted(t_s, t_s - half_s - 1e-9)
    high = np.searchsorted(t_s, t_s + half_s + 1e-9, side="right")
    for i in range(n):
        a, b = int(low[i]), int(high[i])
        if b - a < 3:
            a = max(0, min(i - 1, n - 3))
            b = min(n, a + 3)
        t = t_s[a:b] - t_s[a:b].mean()
        found[i] = t @ (values[a:b] - values[a:b].mean(axis=0)) / (t @ t)
    return found


def make_track(samples: Samples, body: Body) -> Track:
    """Checks and completes what a source says of one object.

    Raises:
        InputError: stamps go backwards, a value isn't finite, the object jumps, or its speed or
            heading contradicts its positions; the message names unit or frame where one explains
            it.
    """
    who, notes = body.object_id, list[str]()
    samples, repeated = _rising(samples)
    if repeated:
        notes.append(f"{who}: {repeated} samples that repeat the one before were left out")
    _check_finite(samples)
    if len(samples.stamps_ns) < LEAST_SAMPLES:
        raise samples.source.error(
            f"holds {len(samples.stamps_ns)} samples within the crop",
            f"at least {LEAST_SAMPLES} are needed; move --start and --end, or name another source",
        )
    samples = body.transform.applied(samples)
    t_s = (samples.stamps_ns - samples.stamps_ns[0]) / NS_PER_S
    velocity = slopes(t_s, np.column_stack([samples.x_m, samples.y_m]))
    samples, more = _with_heading(samples, body, velocity)
    notes += more
    reported = samples.speed_mps
    samples, more = _with_speed(samples, body, t_s, velocity)
    notes += more
    _check_jumps(samples, t_s, reported if samples.speed_mps is reported else None)
    samples, more = _with_rates(samples, body, t_s)
    samples = _at_reference(samples, body)
    notes += more + _sideways(samples, body, t_s) + _gaps(body, t_s)
    if body.size is None:
        size = body.extent
        notes.append(
            f"{who}: size not given, that of a typical {body.object_class.word} is taken "
            f"({size.length_m:g} x {size.width_m:g} x {size.height_m:g} m)"
        )
    return Track(body, samples, tuple(notes))


def _rising(samples: Samples) -> tuple[Samples, int]:
    """The samples without those that say the same again, and how many there were."""
    steps = np.diff(samples.stamps_ns)
    if (steps < 0).any():
        i = int(np.argmax(steps < 0)) + 1
        late_s = -ns_to_seconds(int(steps[i - 1]))
        raise samples.source.error(
            f"goes back in time by {late_s:.3f} s",
            "a recording of two runs, or of two senders on one topic, can't be measured; cut it",
            index=i,
            value=ns_to_seconds(int(samples.stamps_ns[i])),
        )
    again = np.concatenate([[False], steps == 0])
    if not again.any():
        return samples, 0
    for i in np.flatnonzero(again).tolist():
        if (samples.x_m[i], samples.y_m[i]) != (samples.x_m[i - 1], samples.y_m[i - 1]):
            raise samples.source.error(
                "has two positions at one time",
                "one id must be one object; name the senders apart",
                index=i,
                value=ns_to_seconds(int(samples.stamps_ns[i])),
            )
    return samples.taken(~again), int(again.sum())


def _check_finite(samples: Samples) -> None:
    for name in ("x_m", "y_m", "yaw_rad", "speed_mps", "yaw_rate_radps", "acceleration_mps2"):
        values = getattr(samples, name)
        if values is not None and not np.isfinite(values).all():
            i = int(np.argmin(np.isfinite(values)))
            raise samples.source.error(
                f"has a {name} that is no number at {ns_to_seconds(int(samples.stamps_ns[i])):g} s",
                "cut the span out with --start and --end, or mend the source",
                index=i,
                value=float(values[i]),
            )


def _with_heading(samples: Samples, body: Body, velocity: FloatArray) -> tuple[Samples, list[str]]:
    """Headings from the source, or from the motion where it has none."""
    given = samples.yaw_rad
    if given is not None and not body.heading_from_motion:
        _check_heading(samples, given, body, velocity)
        return samples, []
    moved = np.linalg.norm(velocity, axis=1)
    fast = np.flatnonzero(moved >= MOVING_MPS / 2.0)
    if not len(fast):
        raise samples.source.error(
            f"has no heading to be had from its motion: it never moves faster than "
            f"{moved.max():.2f} m/s",
            "name a source with headings",
        )
    course = np.unwrap(np.arctan2(velocity[fast, 1], velocity[fast, 0]))
    # Standing, an object looks where it went last; before it sets out, where it will go.
    held = np.clip(np.searchsorted(fast, np.arange(len(moved)), side="right") - 1, 0, None)
    note = (
        f"{body.object_id}: heading derived from its positions, a line through the samples within "
        f"{SLOPE_HALF_S:g} s; below {MOVING_MPS / 2.0:g} m/s the last one is held"
    )
    return replace(samples, yaw_rad=course[held]), [note]


def _check_heading(samples: Samples, yaw_rad: FloatArray, body: Body, velocity: FloatArray) -> None:
    speed = np.linalg.norm(velocity, axis=1)
    moving = speed >= MOVING_MPS
    too_large = np.abs(yaw_rad) > 2.0 * math.pi + 0.01
    if too_large.any():
        i = int(np.argmax(too_large))
        raise samples.source.error(
            "has a heading of more than one turn: degrees?",
            "headings are in rad, counter-clockwise from +x",
            index=i,
            value=float(yaw_rad[i]),
        )
    if not moving.any():
        return
    course = np.arctan2(velocity[moving, 1], velocity[moving, 0])
    if samples.speed_mps is not None:
        course = course + math.pi * (samples.speed_mps[moving] < 0.0)
    own = yaw_rad[moving]

    def off_rad(heading: FloatArray) -> float:
        return float(np.median(np.abs((heading - course + math.pi) % (2 * math.pi) - math.pi)))

    walker = body.object_class is ObjectClass.PEDESTRIAN
    off = off_rad(own)
    if off <= (WALKER_HEADING_RAD if walker else HEADING_RAD):
        return
    guesses = {
        "they look like degrees": np.radians(own),
        "they look like compass degrees, clockwise from north": np.radians(90.0 - own),
        "they look clockwise from +y, as a compass counts": math.pi / 2.0 - own,
        "they look clockwise, as in a left-handed frame": -own,
        "they look turned by half a turn: does y or the order of axes agree with x?": own + math.pi,
    }
    best = min(guesses, key=lambda text: off_rad(guesses[text]))
    hint = f" ({best})" if off_rad(guesses[best]) < HEADING_RAD / 2.0 else ""
    i = int(np.flatnonzero(moving)[0])
    raise samples.source.error(
        f"has headings that lie {math.degrees(off):.0f} degrees off its direction of motion{hint}",
        "headings are in rad, counter-clockwise from +x; where the source has none that hold, "
        f"--heading {body.object_id}=motion takes them from the motion",
        index=i,
        value=float(yaw_rad[i]),
    )


def _with_speed(
    samples: Samples, body: Body, t_s: FloatArray, velocity: FloatArray
) -> tuple[Samples, list[str]]:
    """Speeds from the source where they agree with the positions, or from the positions."""
    if samples.yaw_rad is None:
        raise ValueError("headings come first")
    yaw = samples.yaw_rad
    along = velocity[:, 0] * np.cos(yaw) + velocity[:, 1] * np.sin(yaw)
    way_m = float(np.linalg.norm(np.diff(np.column_stack([samples.x_m, samples.y_m]), axis=0),
                                 axis=1).sum())  # fmt: skip
    given = samples.speed_mps
    why = "the source has none"
    if given is not None and way_m > _LEAST_WAY_M and not np.any(given):
        given, why = None, "those of the source are all zero while its positions move"
    if given is None:
        note = (
            f"{body.object_id}: speed derived from its positions, a line through the samples "
            f"within {SLOPE_HALF_S:g} s ({why})"
        )
        return replace(samples, speed_mps=along), [note]
    covered = np.linalg.norm(velocity, axis=1)
    moving = np.maximum(np.abs(given), covered) >= MOVING_MPS
    # What a median of a short way says is noise.
    if way_m > _LEAST_WAY_M and moving.sum() >= 3:
        ratio = float(np.median(np.abs(given[moving]) / np.maximum(covered[moving], 1e-3)))
        if not 1.0 / SPEED_RATIO <= ratio <= SPEED_RATIO:
            i = int(np.flatnonzero(moving)[len(np.flatnonzero(moving)) // 2])
            raise samples.source.error(
                f"has speeds {ratio:.3g} times those of its positions ({covered[i]:.2f} m/s at "
                f"{t_s[i]:.2f} s after its first sample){_unit_hint(ratio)}",
                "speeds are in m/s, positions in m, times in s, all of one run",
                index=i,
                value=float(given[i]),
            )
    return samples, []


def _unit_hint(ratio: float) -> str:
    for factor, text in (
        (3.6, "speeds in km/h"),
        (2.23694, "speeds in miles per hour"),
        (1.94384, "speeds in knots"),
        (1000.0, "times in ms, or positions in km"),
        (0.01, "positions in cm"),
        (0.001, "positions in mm"),
        (0.3048, "positions in feet"),
    ):
        if abs(ratio / factor - 1.0) < 0.1:
            return f": {text}?"
    return ": another run's, or another time base?"


def _check_jumps(samples: Samples, t_s: FloatArray, speed_mps: FloatArray | None) -> None:
    """Raises InputError where an id goes over to another object, or to another place.

    Args:
        samples: of one object.
        t_s: their times.
        speed_mps: as reported; None: what its steps have around each of them.
    """
    steps_s = np.diff(t_s)
    way_m = np.hypot(np.diff(samples.x_m), np.diff(samples.y_m))
    if speed_mps is None:
        around = np.pad(way_m / steps_s, 2, mode="edge")
        usual = np.median(np.lib.stride_tricks.sliding_window_view(around, 5), axis=1)
    else:
        usual = np.maximum(np.abs(speed_mps[1:]), np.abs(speed_mps[:-1]))
    jump = way_m > usual * steps_s + JUMP_M
    if jump.any():
        i = int(np.argmax(jump)) + 1
        raise samples.source.error(
            f"jumps by {way_m[i - 1]:.1f} m within {steps_s[i - 1]:.2f} s: one id must be one "
            "object",
            "mend the ids, or cut the span out with --start and --end",
            index=i,
            value=(round(float(samples.x_m[i]), 3), round(float(samples.y_m[i]), 3)),
        )


def _sideways(samples: Samples, body: Body, t_s: FloatArray) -> list[str]:
    """Says where a reference point moves across its heading, which states can't hold."""
    yaw, speed, _, _ = _complete(samples)
    steps_s = np.diff(t_s)[:, None]
    reported = speed[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
    went = np.concatenate(
        [np.zeros((1, 2)), np.cumsum((reported[1:] + reported[:-1]) / 2.0 * steps_s, axis=0)]
    )
    # What the positions do beyond where speed and heading lead.
    beyond = slopes(t_s, np.column_stack([samples.x_m, samples.y_m]) - went, _SIDEWAYS_HALF_S)
    across = np.abs(beyond[:, 1] * np.cos(yaw) - beyond[:, 0] * np.sin(yaw))
    if across.max() <= OBSERVABLE_LATERAL_MPS:
        return []
    i = int(np.argmax(across))
    return [
        f"{body.object_id}: moves across its heading by up to {across[i]:.2f} m/s, at {t_s[i]:.2f} "
        "s after its first sample; states hold the speed along the heading only (--heading "
        f"{body.object_id}=motion takes the heading from the motion)"
    ]


def _with_rates(samples: Samples, body: Body, t_s: FloatArray) -> tuple[Samples, list[str]]:
    """Yaw rate and acceleration where the source has none."""
    if samples.yaw_rad is None or samples.speed_mps is None:
        raise ValueError("headings and speeds come first")
    derived = []
    changes = slopes(t_s, np.column_stack([np.unwrap(samples.yaw_rad), samples.speed_mps]))
    if samples.yaw_rate_radps is None or body.heading_from_motion:
        samples = replace(samples, yaw_rate_radps=changes[:, 0])
        derived.append("yaw rate from its headings")
    if samples.acceleration_mps2 is None:
        samples = replace(samples, acceleration_mps2=changes[:, 1])
        derived.append("acceleration from its speeds")
    if not derived:
        return samples, []
    how = f"a line through the samples within {SLOPE_HALF_S:g} s"
    return samples, [f"{body.object_id}: {' and '.join(derived)}, {how}"]


def _gaps(body: Body, t_s: FloatArray) -> list[str]:
    """Says where states are missing for longer than one is carried on."""
    steps = np.diff(t_s)
    gaps = np.flatnonzero(steps > STATE_AGE_S + 1e-9)
    if not len(gaps):
        return []
    worst = int(gaps[np.argmax(steps[gaps])])
    return [
        f"{body.object_id}: {len(gaps)} gaps of more than {STATE_AGE_S:g} s, the longest "
        f"{steps[worst]:.2f} s from {t_s[worst]:.2f} s after its first sample on"
    ]


def _at_reference(samples: Samples, body: Body) -> Samples:
    """The samples moved to the reference point of ObjectState.msg, the rear axle of a vehicle."""
    if samples.yaw_rad is None:
        raise ValueError("headings come first")
    ahead_m = body.ahead_m
    return replace(
        samples,
        x_m=samples.x_m - ahead_m * np.cos(samples.yaw_rad),
        y_m=samples.y_m - ahead_m * np.sin(samples.yaw_rad),
    )
