"""The motion of one object as a source gives it, checked and completed (METHOD 4.3).

Whatever recorded it, a track ends as the states of an object's reference point in frame map:
positions, headings and speeds that agree with each other, on one clock.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
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
from ssp_eval.importers.contradiction_texts import problem_and_remedy
from ssp_eval.importers.contradictions import Course, contradictions, twist_in_parent_axes
from ssp_eval.importers.findings import Finding, Findings
from ssp_eval.recordings.states import STATE_AGE_S

# Derivatives are the slope of a straight line through the samples this near in time.
SLOPE_HALF_S = 0.15
# A slope needs as many.
LEAST_SAMPLES = 3
# Slower than this, the direction of motion says nothing.
MOVING_MPS = 1.0
_LEAST_WAY_M = 2.0
_SIDEWAYS_HALF_S = 0.5
# So many states at once are plain numbers; the others stay in their arrays.
_BLOCK = 4096
Stamps = NDArray[np.int64]

ReferencePoint = Literal["rear_axle", "centre", "front", "rear"]


@dataclass(frozen=True)
class Source:
    """The place of a track, for errors.

    Args:
        field: topic, or id in the table.
        lines: of the table, one a sample; None: the source has no lines.
    """

    file: Path
    field: str
    lines: Sequence[int] | None = None

    def error(
        self, problem: str, remedy: str, *, index: int | None = None, value: object = None
    ) -> InputError:
        line = None if self.lines is None or index is None else self.lines[index]
        return InputError(
            problem, file=self.file, line=line, field=self.field, value=value, remedy=remedy
        )

    def finding(
        self, name: str, problem: str, remedy: str, *, index: int, value: object = None
    ) -> Finding:
        """Name what contradicts itself; ``index`` is that of the first sample of it."""
        line = None if self.lines is None else self.lines[index]
        return Finding(name, problem, remedy, self.file, self.field, line, value)


@dataclass(frozen=True)
class Samples:
    """The source's samples of one object, one entry a sample, in the order of the source.

    Args:
        stamps_ns: on the source's clock.
        columns: x_m and y_m of the point that is reported; as far as the source has them yaw_rad
            (counter-clockwise from +x), speed_mps and acceleration_mps2 (along the heading,
            backwards is negative), left_mps (across it) and yaw_rate_radps.
    """

    stamps_ns: Stamps
    columns: Mapping[str, FloatArray]
    source: Source

    def __getitem__(self, column: str) -> FloatArray:
        return self.columns[column]

    @property
    def xy_m(self) -> FloatArray:
        """Positions, shape (n, 2)."""
        return np.column_stack([self["x_m"], self["y_m"]])

    def having(self, **columns: FloatArray) -> Samples:
        """Return the same with these columns."""
        return replace(self, columns={**self.columns, **columns})

    def select(self, keep: NDArray[np.bool_] | Stamps) -> Samples:
        """Return only these samples."""
        lines = self.source.lines
        sample_lines = None if lines is None else tuple(np.asarray(lines)[keep].tolist())
        return Samples(
            self.stamps_ns[keep],
            {name: values[keep] for name, values in self.columns.items()},
            replace(self.source, lines=sample_lines),
        )

    def moved_ahead(self, ahead_m: float) -> Samples:
        """Return the samples of a point so far ahead, along the heading."""
        yaw = self["yaw_rad"]
        return self.having(
            x_m=self["x_m"] + ahead_m * np.cos(yaw), y_m=self["y_m"] + ahead_m * np.sin(yaw)
        )


@dataclass(frozen=True)
class Rigid:
    """A rigid motion in the plane: turned by yaw about the origin, then moved."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0

    def applied(self, samples: Samples) -> Samples:
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x_m, y_m = samples["x_m"], samples["y_m"]
        new_samples = samples.having(
            x_m=c * x_m - s * y_m + self.x_m, y_m=s * x_m + c * y_m + self.y_m
        )
        if "yaw_rad" not in samples.columns:
            return new_samples
        return new_samples.having(yaw_rad=samples["yaw_rad"] + self.yaw_rad)


@dataclass(frozen=True)
class Body:
    """The facts about an object beside its motion.

    Args:
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
        """Return how far the reported point lies ahead of ObjectState.msg's reference point."""
        if isinstance(self.reference, float):
            return self.reference
        front_m, rear_m = self.extent.front_m, self.extent.rear_m
        middle_m = (front_m - rear_m) / 2.0
        places = {"rear_axle": 0.0, "centre": middle_m, "front": front_m, "rear": -rear_m}
        return places[self.reference]


def size_of(object_class: ObjectClass, length_m: float, width_m: float, height_m: float) -> Size:
    """Return the extent of an object of these outer measures.

    The reference point divides its length as it divides that of the typical object of its class.
    """
    typical = DEFAULT_SIZES[object_class]
    front_m = length_m * typical.front_m / typical.length_m
    return Size(front_m, length_m - front_m, width_m, height_m)


@dataclass(frozen=True)
class Track:
    """The states of one object's reference point in frame map, stamps rising.

    Args:
        samples: with all columns.
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
        """Yield the states, numbered from 1; ``zero_ns`` is taken from every stamp."""
        body, samples = self.body, self.samples
        names = [name for name in samples.columns if name != "left_mps"]
        for begin in range(0, len(samples.stamps_ns), _BLOCK):
            block = slice(begin, begin + _BLOCK)
            rows = zip(*(samples[name][block].tolist() for name in names), strict=True)
            stamps_ns = samples.stamps_ns[block].tolist()
            for i, (stamp_ns, values) in enumerate(zip(stamps_ns, rows, strict=True), begin + 1):
                row = dict(zip(names, values, strict=True))
                yield ObjectState(
                    object_id=body.object_id,
                    object_class=body.object_class,
                    role=body.role,
                    stamp_ns=stamp_ns - zero_ns,
                    size=body.extent,
                    sequence=i,
                    **(row | {"yaw_rad": wrap_angle(row["yaw_rad"])}),
                )


def slopes(t_s: FloatArray, values: FloatArray, half_s: float = SLOPE_HALF_S) -> FloatArray:
    """Return the derivative of each column by a straight line through the samples near in time.

    Args:
        t_s: shape (n,), rising, at least two.
        values: shape (n, k).
        half_s: samples up to this far away count; always at least three.

    Returns:
        Shape (n, k), per second.
    """
    n = len(t_s)
    derivative = np.zeros_like(values)
    low = np.searchsorted(t_s, t_s - half_s - 1e-9)
    high = np.searchsorted(t_s, t_s + half_s + 1e-9, side="right")
    for i in range(n):
        a, b = int(low[i]), int(high[i])
        if b - a < LEAST_SAMPLES:
            a = max(0, min(i - 1, n - LEAST_SAMPLES))
            b = min(n, a + LEAST_SAMPLES)
        t = t_s[a:b] - t_s[a:b].mean()
        derivative[i] = t @ (values[a:b] - values[a:b].mean(axis=0)) / (t @ t)
    return derivative


def make_track(samples: Samples, body: Body, findings: Findings) -> Track:
    """Check and complete what a source states of one object.

    Args:
        samples: as the source has them, within the crop.
        body: the object, its reported point and its axes.
        findings: take where speed, heading or steps contradict the positions; the message names
            unit or frame where one explains it.

    Raises:
        InputError: stamps go backwards, a value isn't finite, or there are too few samples.
    """
    notes: list[str] = []
    samples = _rising(samples, body, notes)
    _check_finite(samples)
    if len(samples.stamps_ns) < LEAST_SAMPLES:
        raise samples.source.error(
            f"holds {len(samples.stamps_ns)} samples within the crop",
            f"at least {LEAST_SAMPLES} are needed; move --start and --end, or name another source",
        )
    t_s = (samples.stamps_ns - samples.stamps_ns[0]) / NS_PER_S
    axes = _axes_finding(samples, body, t_s)
    if "yaw_rad" in samples.columns and not body.heading_from_motion:
        _check_turns(samples)
    samples = body.transform.applied(samples)
    reported_xy_m = samples.xy_m
    velocity = slopes(t_s, reported_xy_m)
    samples, has_heading = _with_heading(samples, body, velocity, notes)
    samples, has_speeds = _with_speed(samples, body, velocity, notes)
    samples = _with_rates(samples, body, t_s, notes).moved_ahead(-body.ahead_m)
    course = Course(
        body.object_class,
        t_s,
        samples.xy_m,
        reported_xy_m,
        samples["yaw_rad"] if has_heading else None,
        samples["speed_mps"] if has_speeds else None,
    )
    track_findings = _findings(samples, body, course, velocity)
    if axes is not None:
        # What the wrong axes bring about isn't named beside them.
        track_findings = [one for one in track_findings if one.name in ("leap", "clock_step")] + [
            axes
        ]
    for one in track_findings:
        findings.add(one)
    if "sideways" not in [one.name for one in track_findings]:
        _say_sideways(samples, body, t_s, notes)
    _say_gaps(body, t_s, notes)
    if body.size is None:
        size = body.extent
        notes.append(
            f"{body.object_id}: size not given, that of a typical {body.object_class.word} is "
            f"taken ({size.length_m:g} x {size.width_m:g} x {size.height_m:g} m)"
        )
    return Track(body, samples, tuple(notes))


def _rising(samples: Samples, body: Body, notes: list[str]) -> Samples:
    """Return the samples without those that say the same again."""
    steps = np.diff(samples.stamps_ns)
    if (steps < 0).any():
        i = int(np.argmax(steps < 0)) + 1
        raise samples.source.error(
            f"goes back in time by {-ns_to_seconds(int(steps[i - 1])):.3f} s",
            "a recording of two runs, or of two senders on one topic, can't be measured; cut it",
            index=i,
            value=ns_to_seconds(int(samples.stamps_ns[i])),
        )
    again = np.concatenate([[False], steps == 0])
    if not again.any():
        return samples
    moved = again & np.concatenate([[False], (np.diff(samples.xy_m, axis=0) != 0.0).any(axis=1)])
    if moved.any():
        i = int(np.argmax(moved))
        raise samples.source.error(
            "has two positions at one time",
            "one id must be one object; name the senders apart",
            index=i,
            value=ns_to_seconds(int(samples.stamps_ns[i])),
        )
    notes.append(
        f"{body.object_id}: {int(again.sum())} samples that repeat the one before were left out"
    )
    return samples.select(~again)


def _check_finite(samples: Samples) -> None:
    for name, values in samples.columns.items():
        if not np.isfinite(values).all():
            i = int(np.argmin(np.isfinite(values)))
            after_s = ns_to_seconds(int(samples.stamps_ns[i] - samples.stamps_ns[0]))
            raise samples.source.error(
                f"has a {name} that is no number, {after_s:.3f} s after its first sample",
                "cut the span out with --start and --end, or mend the source",
                index=i,
                value=float(values[i]),
            )


def _with_heading(
    samples: Samples, body: Body, velocity: FloatArray, notes: list[str]
) -> tuple[Samples, bool]:
    """Add headings from the source, or from the motion where it has none.

    Returns:
        The samples, and whether the headings are the source's own.
    """
    if "yaw_rad" in samples.columns and not body.heading_from_motion:
        return samples, True
    moved = np.linalg.norm(velocity, axis=1)
    fast = np.flatnonzero(moved >= MOVING_MPS / 2.0)
    if not len(fast):
        raise samples.source.error(
            f"has a motion too slow to give a heading: it never moves faster than "
            f"{moved.max():.2f} m/s",
            "name a source with headings",
        )
    course = np.unwrap(np.arctan2(velocity[fast, 1], velocity[fast, 0]))
    # Standing, an object looks where it went last; before it sets out, where it will go.
    course_index = np.clip(np.searchsorted(fast, np.arange(len(moved)), side="right") - 1, 0, None)
    notes.append(
        f"{body.object_id}: heading derived from its positions, a line through the samples within "
        f"{SLOPE_HALF_S:g} s; below {MOVING_MPS / 2.0:g} m/s the last one is held"
    )
    return samples.having(yaw_rad=course[course_index]), False


def _check_turns(samples: Samples) -> None:
    """Refuse headings that aren't in rad, as the source states them."""
    yaw = samples["yaw_rad"]
    too_large = np.abs(yaw) > 2.0 * math.pi + 0.01
    if too_large.any():
        i = int(np.argmax(too_large))
        raise samples.source.error(
            "has a heading of more than one turn: degrees?",
            "headings are in rad, counter-clockwise from +x",
            index=i,
            value=float(yaw[i]),
        )


def _with_speed(
    samples: Samples, body: Body, velocity: FloatArray, notes: list[str]
) -> tuple[Samples, bool]:
    """Add speeds from the source, or from the positions where it has none.

    Returns:
        The samples, and whether the speeds are the source's own.
    """
    yaw, speeds_mps = samples["yaw_rad"], samples.columns.get("speed_mps")
    way_m = float(np.linalg.norm(np.diff(samples.xy_m, axis=0), axis=1).sum())
    why = "the source has none"
    left = samples.columns.get("left_mps", speeds_mps)
    if speeds_mps is not None and way_m > _LEAST_WAY_M and not (np.any(speeds_mps) or np.any(left)):
        speeds_mps, why = None, "those of the source are all zero while its positions move"
    if speeds_mps is not None:
        return samples, True
    notes.append(
        f"{body.object_id}: speed derived from its positions, a line through the samples within "
        f"{SLOPE_HALF_S:g} s ({why})"
    )
    along = velocity[:, 0] * np.cos(yaw) + velocity[:, 1] * np.sin(yaw)
    return samples.having(speed_mps=along), False


def _axes_finding(samples: Samples, body: Body, t_s: FloatArray) -> Finding | None:
    """Name a twist that is along the axes of the poses' frame, and not along the object's."""
    columns = samples.columns
    if "left_mps" not in columns or body.heading_from_motion:
        return None
    twist = np.column_stack([samples["speed_mps"], samples["left_mps"]])
    fit = twist_in_parent_axes(t_s, samples.xy_m, samples["yaw_rad"], twist)
    if fit is None:
        return None
    own_mps, parent_mps, i = fit
    return samples.source.finding(
        "twist_axes",
        f"has a twist along the axes of its poses' frame, not of its child frame: it fits the "
        f"positions within {parent_mps:.2f} m/s there, and within {own_mps:.2f} m/s as it should "
        "be (REP 105)",
        f"--twist {body.object_id}=parent turns it into the heading",
        index=i,
        value=(round(float(twist[i, 0]), 3), round(float(twist[i, 1]), 3)),
    )


def _findings(samples: Samples, body: Body, course: Course, velocity: FloatArray) -> list[Finding]:
    """Name the places where the source's statements contradict its positions."""
    findings = []
    for one in contradictions(course):
        problem, remedy = problem_and_remedy(one, course, velocity, body.object_id)
        column = {"leap": "x_m", "heading": "yaw_rad"}.get(one.name, "speed_mps")
        at = one.last if one.name == "leap" else one.first
        value: object = float(samples[column][at])
        if one.name == "leap":
            value = (round(float(samples["x_m"][at]), 3), round(float(samples["y_m"][at]), 3))
        findings.append(samples.source.finding(one.name, problem, remedy, index=at, value=value))
    return findings


def _with_rates(samples: Samples, body: Body, t_s: FloatArray, notes: list[str]) -> Samples:
    """Add yaw rate and acceleration where the source has none."""
    turned = np.unwrap(samples["yaw_rad"])
    rate, acceleration = slopes(t_s, np.column_stack([turned, samples["speed_mps"]])).T
    derived = []
    if "yaw_rate_radps" not in samples.columns or body.heading_from_motion:
        samples = samples.having(yaw_rate_radps=rate)
        derived.append("yaw rate from its headings")
    if "acceleration_mps2" not in samples.columns:
        samples = samples.having(acceleration_mps2=acceleration)
        derived.append("acceleration from its speeds")
    if derived:
        notes.append(
            f"{body.object_id}: {' and '.join(derived)}, a line through the samples within "
            f"{SLOPE_HALF_S:g} s"
        )
    return samples


def _say_sideways(samples: Samples, body: Body, t_s: FloatArray, notes: list[str]) -> None:
    """Say where a reference point moves across its heading, which states can't hold."""
    yaw = samples["yaw_rad"]
    reported = samples["speed_mps"][:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
    dead_reckoning_m = np.zeros_like(reported)
    steps_s = np.diff(t_s)[:, None]
    dead_reckoning_m[1:] = np.cumsum((reported[1:] + reported[:-1]) / 2.0 * steps_s, axis=0)
    # What the positions do beyond where speed and heading lead.
    beyond = slopes(t_s, samples.xy_m - dead_reckoning_m, _SIDEWAYS_HALF_S)
    across = np.abs(beyond[:, 1] * np.cos(yaw) - beyond[:, 0] * np.sin(yaw))
    if across.max() > OBSERVABLE_LATERAL_MPS:
        i = int(np.argmax(across))
        notes.append(
            f"{body.object_id}: moves across its heading by up to {across[i]:.2f} m/s, at "
            f"{t_s[i]:.2f} s after its first sample; states hold the speed along the heading only "
            f"(--heading {body.object_id}=motion takes the heading from the motion)"
        )


def _say_gaps(body: Body, t_s: FloatArray, notes: list[str]) -> None:
    """Say where states are missing for longer than one is carried on."""
    steps = np.diff(t_s)
    gaps = steps > STATE_AGE_S + 1e-9
    if gaps.any():
        worst = int(np.argmax(steps))
        notes.append(
            f"{body.object_id}: {int(gaps.sum())} gaps of more than {STATE_AGE_S:g} s, the longest "
            f"{steps[worst]:.2f} s from {t_s[worst]:.2f} s after its first sample on"
        )
