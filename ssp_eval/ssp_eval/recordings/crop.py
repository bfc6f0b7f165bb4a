"""The clip of a recording: one crop for audit, labels and evaluation (METHOD 4.1).

A recording holds more than the event, so every one is cropped as the source was: from its trigger
minus a to its resolution plus r, where a and r are the source's own lengths of approach and
resolution.
"""

from __future__ import annotations

from dataclasses import dataclass

# METHOD 4.1: approach and resolution count as located if so much of each lies in the clip.
LOCATED_S = 0.5
TOLERANCE_S = 1e-9
# K*'s times are rounded to milliseconds.
_SHOWN_S = 0.0015


@dataclass(frozen=True, slots=True)
class Window:
    """How much of the source lies before its trigger and after its resolution's start, s.

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
        """True for a time inside, ends included."""
        return self.start_s - TOLERANCE_S <= t_s <= self.end_s + TOLERANCE_S

    @property
    def shortfall(self) -> str:
        """By how much the recording is short of the window; empty where it isn't."""
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
    """The clip of a recording (METHOD 4.1).

    Args:
        first_s: beginning of the recording.
        last_s: its end.
        trigger_s: start of its trigger; None: the clip is the whole recording.
        resolution_s: start of its resolution; None: the clip ends with the recording.
        window: of the source; None: nobody knows it, and the clip is the whole recording.
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
