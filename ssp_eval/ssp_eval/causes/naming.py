"""Objects that are named and not there, and those that are there and not named.

What is there comes from a recording's ground truth and what of it the camera shows; a recording
without both has no such rates.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

import numpy as np

from ssp_core.bag.reader import BagReader
from ssp_core.cdr.messages import object_state, peek_stamp_ns
from ssp_core.errors import InputError
from ssp_core.motion.state import ObjectState
from ssp_core.names import WORLD_TICK, absolute
from ssp_eval.causes.answers import Asked
from ssp_eval.recordings.clip import Clip
from ssp_eval.recordings.sight import MIN_SHARE, Optics, object_share
from ssp_eval.statistics.paired import rate_interval
from ssp_eval.statistics.resampling import NO_INTERVAL, Interval

# The event is there, and nobody may miss who makes it.
CRITICAL = frozenset({"trigger", "conflict"})


@dataclass(frozen=True)
class Seen:
    """What one frame shows.

    Args:
        shown: classes of which it shows anything.
        critical: classes of object targets that it shows well (MIN_SHARE).
    """

    shown: frozenset[str]
    critical: frozenset[str]


@dataclass(frozen=True)
class Naming:
    """A model's rates under one condition; means over recordings.

    Args:
        named: classes that it named, over all label times; recordings_named: where it named any.
        hallucinated: share of them of which none of the frames that it was given shows anything;
            None where it named none.
        critical: classes of object targets that the newest frame shows well, at label times of
            trigger and conflict.
        omitted: share of them that it didn't name; None where there were none.
    """

    model: str
    condition: str
    recordings: int
    named: int
    recordings_named: int
    hallucinated: float | None
    critical: int
    recordings_critical: int
    omitted: float | None

    @property
    def hallucinated_interval(self) -> Interval:
        """Wilson's, 95 %, over recordings."""
        return _interval(self.hallucinated, self.recordings_named)

    @property
    def omitted_interval(self) -> Interval:
        """Wilson's, 95 %, over recordings."""
        return _interval(self.omitted, self.recordings_critical)


def _interval(rate: float | None, n: int) -> Interval:
    return NO_INTERVAL if rate is None else rate_interval(rate, n)


def namings(cells: Iterable[Asked]) -> list[Naming]:
    """The rates of each model, for factual questions and for those about twins.

    Cells whose recording has no ground truth, or isn't where it was, are left out.
    """
    listed = [cell for cell in cells if cell.bag is not None]
    stamps: dict[Path, set[int]] = {}
    for cell in listed:
        for of_label in cell.frames_ns.values():
            stamps.setdefault(_bag(cell), set()).update(of_label)
    hashes = {_bag(cell): cell.bag_sha256 for cell in listed}
    seen = {bag: sights(bag, hashes[bag], sorted(at)) for bag, at in sorted(stamps.items())}
    groups: dict[tuple[str, str], list[Asked]] = {}
    for cell in listed:
        if seen.get(_bag(cell)):
            groups.setdefault((cell.model, cell.condition), []).append(cell)
    return [
        _naming(model, condition, [(cell, seen[_bag(cell)]) for cell in of])
        for (model, condition), of in sorted(groups.items())
    ]


def _bag(cell: Asked) -> Path:
    if cell.bag is None:
        raise ValueError("a cell without a recording")
    return cell.bag.resolve()


def _naming(
    model: str, condition: str, cells: Sequence[tuple[Asked, Mapping[int, Seen]]]
) -> Naming:
    sums: dict[str, np.ndarray] = {}
    for cell, seen in cells:
        counts = np.array(_counts(cell, seen))
        sums[cell.recording] = sums.get(cell.recording, np.zeros(4, dtype=np.int64)) + counts
    each = [of.tolist() for of in sums.values()]
    false = [wrong / named for wrong, named, _, _ in each if named]
    missed = [lacking / critical for _, _, lacking, critical in each if critical]
    return Naming(
        model, condition, len(sums), sum(of[1] for of in each), len(false),
        fmean(false) if false else None, sum(of[3] for of in each), len(missed),
        fmean(missed) if missed else None,
    )  # fmt: skip


def _counts(cell: Asked, seen: Mapping[int, Seen]) -> tuple[int, int, int, int]:
    """Named and not shown, named, critical and not named, critical; over the label times."""
    wrong = named = lacking = critical = 0
    for t_s, answer in cell.answers.items():
        frames = [seen[stamp] for stamp in cell.frames_ns.get(t_s, ()) if stamp in seen]
        if answer is None or not frames:
            continue
        said = answer.objects or frozenset()
        shown = frozenset().union(*(frame.shown for frame in frames))
        named, wrong = named + len(said), wrong + len(said - shown)
        if cell.phases.get(t_s) in CRITICAL:
            needed = frames[-1].critical
            critical, lacking = critical + len(needed), lacking + len(needed - said)
    return wrong, named, lacking, critical


def sights(bag: Path, sha256: str | None, stamps_ns: Sequence[int]) -> dict[int, Seen]:
    """What a recording's frames show, by their stamps.

    Args:
        sha256: that the recording must have.
        stamps_ns: of the frames that are wanted, rising.

    Returns:
        Empty where the recording isn't there or is another one, or has no ground truth or camera.
    """
    if not bag.exists():
        return {}
    try:
        with Clip(bag) as clip:
            who, optics = clip.provenance.participants, clip.optics
            if who is None or optics is None or clip.provenance.bag_sha256 != sha256:
                return {}
        ticks = _ticks(bag, stamps_ns)
    except InputError:
        return {}
    return {
        stamp: _seen(states, optics, who.vut, frozenset(who.targets))
        for stamp, states in ticks.items()
    }


def _ticks(bag: Path, stamps_ns: Sequence[int]) -> dict[int, dict[str, ObjectState]]:
    """The world's states by id at each of these stamps: the newest ones then."""
    topic = absolute(WORLD_TICK)
    with BagReader(bag) as reader:
        if topic not in reader.topics:
            return {}
        messages = {peek_stamp_ns(m.data): m for m in reader.messages([topic])}
        known = sorted(messages)
        found = {}
        for stamp in stamps_ns:
            at = bisect_right(known, stamp) - 1
            if at >= 0:
                objects = reader.decode(messages[known[at]]).objects
                states = [object_state(one).extrapolated(stamp) for one in objects]
                found[stamp] = {state.object_id: state for state in states}
    return found


def _seen(
    states: Mapping[str, ObjectState], optics: Optics, vut: str, targets: frozenset[str]
) -> Seen:
    if vut not in states:
        return Seen(frozenset(), frozenset())
    view = optics.view(states[vut].pose)
    shares = {}
    for key, state in states.items():
        others = [other for name, other in states.items() if name not in (key, vut)]
        if key != vut:
            shares[key] = object_share(view, state, others)
    return Seen(
        frozenset(states[key].object_class.word for key, share in shares.items() if share > 0.0),
        frozenset(
            states[key].object_class.word
            for key, share in shares.items()
            if share >= MIN_SHARE and key in targets
        ),
    )
