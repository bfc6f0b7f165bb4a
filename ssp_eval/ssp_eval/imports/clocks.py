"""The clocks of a recording's topics: do their stamps mean the same time?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError

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
    """The times of one topic's messages, in the order of the recording.

    Args:
        topic: its name.
        stamps_ns: of their headers.
        received_ns: by the recorder.
    """

    topic: str
    stamps_ns: _NS
    received_ns: _NS

    def on(self, clock: Clock) -> _NS:
        return self.stamps_ns if clock == "header" else self.received_ns

    @property
    def delay_s(self) -> NDArray[np.float64]:
        """From stamp to receipt, in s."""
        found: NDArray[np.float64] = (self.received_ns - self.stamps_ns) / NS_PER_S
        return found


def check_clocks(file: Path, clock: Clock, topics: Sequence[Times]) -> list[str]:
    """Checks the topics' time bases against each other.

    Args:
        file: the bag, for messages.
        clock: whose times are used.
        topics: the VUT's first; the others are compared with it.

    Returns:
        What is to be known of them.

    Raises:
        InputError: stamps are missing or go backwards, or two topics are on two clocks.
    """
    if clock == "receive":
        return ["times are those of receipt by the recorder; stamps were left aside"]
    for one in topics:
        _check_stamps(file, one)
    notes = []
    first = topics[0]
    for one in topics:
        spread_s = float(np.ptp(np.percentile(one.delay_s, (5, 95))))
        if spread_s > _SAID_S:
            notes.append(
                f"{one.topic}: receipt comes {np.median(one.delay_s):.3f} s after the stamp, "
                f"within {spread_s:.3f} s (5th to 95th percentile)"
            )
    for other in topics[1:]:
        late_s = _later_s(other, first)
        if not len(late_s):
            continue
        apart_s = float(np.median(late_s))
        if abs(apart_s) > APART_S:
            raise InputError(
                f"its stamps lie {abs(apart_s):.3f} s {'before' if apart_s > 0 else 'after'} those "
                f"of {first.topic}, by when both were received: two clocks",
                file=file, field=other.topic,
                remedy="set the recorder's clocks, or take the times of receipt with "
                "--clock receive",
            )  # fmt: skip
        third = max(1, len(late_s) // 3)
        drift_s = float(np.median(late_s[-third:]) - np.median(late_s[:third]))
        if abs(drift_s) > DRIFT_S:
            raise InputError(
                f"its stamps drift by {drift_s:.3f} s against those of {first.topic} over the "
                "recording: two clocks",
                file=file, field=other.topic,
                remedy="take the times of receipt with --clock receive",
            )  # fmt: skip
        if abs(apart_s) > _SAID_S:
            notes.append(
                f"{other.topic}: delivered {abs(apart_s):.3f} s "
                f"{'later' if apart_s > 0 else 'sooner'} than {first.topic}, by stamp and receipt"
            )
    return notes


def _later_s(other: Times, first: Times) -> NDArray[np.float64]:
    """How much later than the first topic's another's messages are received, by their stamps.

    Compared at the same times of receipt: a simulator's time may run slower than the recorder's.
    """
    low, high = first.received_ns[0], first.received_ns[-1]
    both = (other.received_ns >= low) & (other.received_ns <= high)
    received_s = (other.received_ns[both] - low) / NS_PER_S
    beside = np.interp(received_s, (first.received_ns - low) / NS_PER_S, first.delay_s)
    found: NDArray[np.float64] = other.delay_s[both] - beside
    return found


def _check_stamps(file: Path, times: Times) -> None:
    remedy = "take the times of receipt with --clock receive"
    zero = int((times.stamps_ns == 0).sum())
    # A simulator's time begins at 0, once.
    begins = zero == 1 and times.stamps_ns[0] == 0 and times.stamps_ns[1:2].sum() < NS_PER_S
    if zero and not begins:
        raise InputError(
            f"{zero} of {len(times.stamps_ns)} messages have the stamp 0", file=file,
            field=times.topic, remedy=remedy,
        )  # fmt: skip
    back = np.diff(times.stamps_ns) < 0
    if back.any():
        i = int(np.argmax(back)) + 1
        step_s = (times.stamps_ns[i] - times.stamps_ns[i - 1]) / NS_PER_S
        raise InputError(
            f"{int(back.sum())} stamps go backwards, the first by {-step_s:.3f} s",
            file=file,
            field=times.topic,
            value=times.stamps_ns[i] / NS_PER_S,
            remedy=f"name a topic with one sender, or {remedy}",
        )
