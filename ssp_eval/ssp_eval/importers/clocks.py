"""The clocks of a third-party bag: the times of its topics, which must agree."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError
from ssp_eval.importers.findings import Findings

Clock = Literal["header", "receive"]
# Two topics whose stamps lie further apart, measured by when both were received, are on two
# clocks. A camera's driver may take a tenth of a second to deliver.
APART_S = 0.25
# So much may the distance change from a recording's first third to its last.
DRIFT_S = 0.05
# Less than this isn't worth a word.
_SAID_S = 0.02
_NS = NDArray[np.int64]


@dataclass(frozen=True)
class Times:
    """The times of one topic's messages, in the order of the recording."""

    topic: str
    stamps_ns: _NS
    received_ns: _NS

    def on(self, clock: Clock) -> _NS:
        return self.stamps_ns if clock == "header" else self.received_ns

    @property
    def delay_s(self) -> NDArray[np.float64]:
        """Compute the delays from stamp to receipt, in s."""
        delays_s: NDArray[np.float64] = (self.received_ns - self.stamps_ns) / NS_PER_S
        return delays_s


def check_clocks(
    file: Path, clock: Clock, topics: Sequence[Times], findings: Findings
) -> list[str]:
    """Check the topics' time bases against each other.

    They are compared with the topic that most of them agree with; with the first of these where
    there are several.

    Args:
        file: the bag.
        clock: "receive" where the times are those of receipt; these aren't checked.
        topics: the VUT's first.
        findings: take each topic whose stamps are missing or go backwards, or that is on another
            clock.

    Returns:
        What is to be known of them.
    """
    if clock == "receive":
        return ["times are those of receipt by the recorder; stamps were left aside"]
    broken = {one.topic: list(_stamp_errors(file, one)) for one in topics}
    for error in (error for errors in broken.values() for error in errors):
        findings.note("clocks", error)
    notes = []
    for one in topics:
        spread_s = float(np.ptp(np.percentile(one.delay_s, (5, 95))))
        if spread_s > _SAID_S:
            notes.append(
                f"{one.topic}: receipt comes {np.median(one.delay_s):.3f} s after the stamp, "
                f"within {spread_s:.3f} s (5th to 95th percentile)"
            )
    sound = [one for one in topics if not broken[one.topic]]
    first = _most_agreed(sound)
    for other in sound:
        apart = None if first is None or other is first else _apart(other, first)
        if first is None or apart is None:
            continue
        late_s, drift_s = apart
        if abs(late_s) > APART_S:
            findings.note(
                "clocks",
                InputError(
                    f"its stamps lie {abs(late_s):.3f} s {'before' if late_s > 0 else 'after'} "
                    f"those of {first.topic}, by when both were received: two clocks",
                    file=file,
                    field=other.topic,
                    remedy="set the recorder's clocks, or take the times of receipt with "
                    "--clock receive",
                ),
            )
        elif abs(drift_s) > DRIFT_S:
            findings.note(
                "clocks",
                InputError(
                    f"its stamps drift by {drift_s:.3f} s against those of {first.topic} over the "
                    "recording: two clocks",
                    file=file,
                    field=other.topic,
                    remedy="take the times of receipt with --clock receive",
                ),
            )
        elif abs(late_s) > _SAID_S:
            notes.append(
                f"{other.topic}: delivered {abs(late_s):.3f} s "
                f"{'later' if late_s > 0 else 'sooner'} than {first.topic}, by stamp and receipt"
            )
    return notes


def _most_agreed(topics: Sequence[Times]) -> Times | None:
    """Give the topic whose clock most topics have; None: there is none."""

    def others(one: Times) -> int:
        offsets = [_apart(other, one) for other in topics]
        return sum(
            apart is not None and abs(apart[0]) <= APART_S and abs(apart[1]) <= DRIFT_S
            for apart in offsets
        )

    return max(topics, key=others, default=None)


def _apart(other: Times, first: Times) -> tuple[float, float] | None:
    """Compute how much later another topic is received than a first one, and its drift, in s.

    Returns:
        None where they were never received at the same time.
    """
    late_s = _later_s(other, first)
    if not len(late_s):
        return None
    third = max(1, len(late_s) // 3)
    drift_s = float(np.median(late_s[-third:]) - np.median(late_s[:third]))
    return float(np.median(late_s)), drift_s


def _later_s(other: Times, first: Times) -> NDArray[np.float64]:
    """Compute how much later than the first topic's another's messages are received, by stamps.

    Compared at the same times of receipt: a simulator's time may run slower than the recorder's.
    """
    low, high = first.received_ns[0], first.received_ns[-1]
    both = (other.received_ns >= low) & (other.received_ns <= high)
    received_s = (other.received_ns[both] - low) / NS_PER_S
    beside = np.interp(received_s, (first.received_ns - low) / NS_PER_S, first.delay_s)
    lags_s: NDArray[np.float64] = other.delay_s[both] - beside
    return lags_s


def _stamp_errors(file: Path, times: Times) -> Iterator[InputError]:
    """Yield what no clock can have written: stamps of 0, and others that go backwards."""
    remedy = "take the times of receipt with --clock receive"
    is_zero = times.stamps_ns == 0
    zero = int(is_zero.sum())
    # A simulator's time begins at 0, once.
    begins = zero == 1 and times.stamps_ns[0] == 0 and times.stamps_ns[1:2].sum() < NS_PER_S
    if zero and not begins:
        yield InputError(
            f"{zero} of {len(times.stamps_ns)} messages have the stamp 0",
            file=file,
            field=times.topic,
            remedy=remedy,
        )
    stamps_ns = times.stamps_ns[~is_zero]
    back = np.diff(stamps_ns) < 0
    if back.any():
        i = int(np.argmax(back)) + 1
        step_s = (stamps_ns[i] - stamps_ns[i - 1]) / NS_PER_S
        yield InputError(
            f"{int(back.sum())} stamps go backwards, the first by {-step_s:.3f} s",
            file=file,
            field=times.topic,
            value=stamps_ns[i] / NS_PER_S,
            remedy=f"name a topic with one sender, or {remedy}",
        )
