"""Recordings that still lie where a campaign found them: their frames, and the driven path."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ssp_core.bag.frames import Frames, Picture
from ssp_core.bag.reader import BagReader
from ssp_core.cdr.messages import object_state, peek_stamp_ns
from ssp_core.clock import NS_PER_S
from ssp_core.errors import SspError
from ssp_core.geometry import Pose2
from ssp_core.names import CAMERA_IMAGE, VUT_ID, absolute, state_topic
from ssp_eval.figures.ego_path import EgoPath
from ssp_eval.recordings.provenance import content_sha256
from ssp_eval.report.load import CellData
from ssp_vla_bridge.window import Preprocessing, choose

_IMAGE = absolute(CAMERA_IMAGE)
_VUT_STATE = absolute(state_topic(VUT_ID))
# Of a faster camera only so many frames are shown.
MOST_PER_S = 20
# Between poses of the driven path; where there is none for longer, it is not known.
_POSE_NS, _GAP_NS = NS_PER_S // 20, NS_PER_S // 2


@dataclass(frozen=True)
class Recorded:
    """A part of a bag: which frames there are, and where the VUT was.

    Args:
        bag: path of it.
        stamps_ns: of the frames, rising, at most MOST_PER_S.
        log_times_ns: of the same frames.
        driven: poses in the frame of the recording; none where the motion of the VUT is unknown.
    """

    bag: Path
    stamps_ns: tuple[int, ...]
    log_times_ns: tuple[int, ...]
    driven: EgoPath

    @property
    def rate_hz(self) -> float:
        """Frames a second; 0 of fewer than two."""
        passed_ns = self.stamps_ns[-1] - self.stamps_ns[0]
        return (len(self.stamps_ns) - 1) * NS_PER_S / passed_ns if passed_ns else 0.0

    def pictures(self) -> Iterator[Picture]:
        """The frames one by one; what isn't whole is left out."""
        start_ns, stop_ns = min(self.log_times_ns), max(self.log_times_ns) + 1
        with BagReader(self.bag) as bag:
            frames = Frames(bag, _IMAGE, damaged=lambda _, __: None)
            yield from frames.pictures(start_ns, stop_ns, set(self.stamps_ns))


class Recordings:
    """Finds what cells were made from; each bag is hashed once, each part of it read once.

    Args:
        campaign: folder of `ssp evaluate`.
    """

    def __init__(self, campaign: Path) -> None:
        self._campaign = campaign.resolve()
        self._hashes: dict[Path, str | SspError] = {}
        self._parts: dict[tuple[Path, int, int], Recorded | None] = {}

    def find(self, cell: CellData, first_ns: int, last_ns: int) -> Recorded | str:
        """What was recorded of a cell between two stamps; or why it can't be used."""
        told = cell.facts.clip.path
        if told is None:
            return "the campaign doesn't tell where the recording lies"
        path = self._campaign / told
        if not path.exists():
            return "the recording isn't where it was"
        if path not in self._hashes:
            self._hashes[path] = _hash_of(path)
        digest = self._hashes[path]
        if isinstance(digest, SspError):
            return f"the recording can't be read: {digest}"
        if digest != cell.facts.hashes.get("bag"):
            return "another recording lies where it was"
        key = (path, first_ns, last_ns)
        if key not in self._parts:
            self._parts[key] = _read(path, first_ns, last_ns, cell.facts.clip.ego != "unknown")
        return self._parts[key] or "the recording has no frames then"


def _hash_of(path: Path) -> str | SspError:
    try:
        with BagReader(path) as bag:
            return content_sha256(bag)
    except SspError as error:
        return error


def _read(path: Path, first_ns: int, last_ns: int, moved: bool) -> Recorded | None:
    with BagReader(path) as bag:
        found = sorted(
            {peek_stamp_ns(m.data): m.log_time_ns for m in bag.messages([_IMAGE])}.items()
        )
        stamps = [stamp_ns for stamp_ns, _ in found]
        # A request at the first label shows the last frame before it.
        begin, end = max(bisect_right(stamps, first_ns) - 1, 0), bisect_right(stamps, last_ns)
        if begin >= end:
            return None
        whole_s = (stamps[end - 1] - stamps[begin]) / NS_PER_S + 1.0
        rules = Preprocessing(end - begin, 1.0 / MOST_PER_S, whole_s)
        kept = [begin + k for k in choose(stamps[begin:end], end - begin - 1, rules)]
        return Recorded(
            path,
            tuple(found[k][0] for k in kept),
            tuple(found[k][1] for k in kept),
            _driven(bag, first_ns, last_ns) if moved else EgoPath(()),
        )


def _driven(bag: BagReader, first_ns: int, last_ns: int) -> EgoPath:
    """Where the VUT was, from before the first stamp to what a path from the last one shows."""
    poses: dict[int, Pose2] = {}
    if _VUT_STATE in bag.topics:
        for message in bag.messages([_VUT_STATE]):
            stamp_ns = peek_stamp_ns(message.data)
            if first_ns - NS_PER_S <= stamp_ns <= last_ns + 4 * NS_PER_S:
                state = object_state(bag.decode(message))
                poses[stamp_ns] = Pose2(state.x_m, state.y_m, state.yaw_rad)
    pieces: list[list[int]] = []
    for stamp_ns in sorted(poses):
        if pieces and stamp_ns - pieces[-1][-1] < _POSE_NS:
            continue
        if pieces and stamp_ns - pieces[-1][-1] <= _GAP_NS:
            pieces[-1].append(stamp_ns)
        else:
            pieces.append([stamp_ns])
    return EgoPath(tuple((tuple(piece), tuple(poses[s] for s in piece)) for piece in pieces))
