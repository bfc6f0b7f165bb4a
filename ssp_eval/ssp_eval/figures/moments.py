"""What overlays show: for each label time of a cell its frame, plan, recorded path and words."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.bag.frames import Frames, Picture
from ssp_core.bag.reader import BagReader
from ssp_core.cdr.messages import object_state, peek_stamp_ns
from ssp_core.clock import NS_PER_S, seconds_to_ns
from ssp_core.errors import InputError, SspError
from ssp_core.names import CAMERA_IMAGE, VUT_ID, absolute, state_topic
from ssp_eval.data.ego_path import NS, EgoPath, Pose, recorded_paths
from ssp_eval.data.labels import Label
from ssp_eval.data.provenance import content_sha256
from ssp_eval.data.records import BehaviourRecord
from ssp_eval.evaluate.cell_file import frame_path
from ssp_eval.evaluate.results import CellData
from ssp_eval.figures.projection import Ribbon, ribbon
from ssp_eval.score.cell import Judgement
from ssp_eval.score.cli import NULL
from ssp_vla_bridge.trajectory import Trajectory
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
    """Finds what cells were made from; each bag is hashed once, each part of it read once."""

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
    poses: dict[int, Pose] = {}
    if _VUT_STATE in bag.topics:
        for message in bag.messages([_VUT_STATE]):
            stamp_ns = peek_stamp_ns(message.data)
            if first_ns - NS_PER_S <= stamp_ns <= last_ns + 4 * NS_PER_S:
                state = object_state(bag.decode(message))
                poses[stamp_ns] = Pose(stamp_ns * NS, state.x_m, state.y_m, state.yaw_rad)
    pieces: list[list[int]] = []
    for stamp_ns in sorted(poses):
        if pieces and stamp_ns - pieces[-1][-1] < _POSE_NS:
            continue
        if pieces and stamp_ns - pieces[-1][-1] <= _GAP_NS:
            pieces[-1].append(stamp_ns)
        else:
            pieces.append([stamp_ns])
    return EgoPath(tuple(tuple(poses[stamp_ns] for stamp_ns in piece) for piece in pieces))


Image = NDArray[np.uint8]

_HORIZON_S = 3.0
RIGHT, WRONG = "✓", "✗"


@dataclass(frozen=True)
class Moment:
    """One label time of a cell.

    Args:
        stamp_ns: of the request, None where nothing was asked.
        frames: stamp and hash of each frame sent, oldest first.
        record: the answer, None where there is none.
        plan: the valid trajectory, None: there is none.
    """

    label: Label
    judgement: Judgement
    stamp_ns: int | None
    frames: tuple[tuple[int, str], ...]
    record: BehaviourRecord | None
    plan: Trajectory | None

    @property
    def says(self) -> str:
        """The actions that the text commits to, marked right or wrong."""
        found = self.judgement
        return _actions(found.text_lon, found.text_lat, self.label)

    @property
    def plans(self) -> str:
        """The actions that the trajectory makes, marked right or wrong."""
        found = self.judgement
        return _actions(found.trajectory_lon, found.trajectory_lat, self.label)

    @property
    def allowed(self) -> str:
        """The actions that are right here."""
        return f"{' / '.join(self.label.lon_actions)}, {' / '.join(self.label.lat_actions)}"


def _actions(lon: str | None, lat: str | None, label: Label) -> str:
    if lon is None and lat is None:
        return NULL
    mark = RIGHT if lon in label.lon_actions and lat in label.lat_actions else WRONG
    return f"{lon or NULL}, {lat or NULL} {mark}"


@dataclass(frozen=True)
class CellOverlay:
    """A scored cell as overlays tell it.

    Args:
        part: of the bag, None: it can't be read any more.
        lost: why it can't.
    """

    cell: CellData
    out: Path
    moments: tuple[Moment, ...]
    part: Recorded | None = None
    lost: str = ""

    @cached_property
    def path(self) -> EgoPath:
        """Where the VUT was, as the recording tells, or as far as the requests do."""
        if self.part is not None:
            return self.part.driven
        known = [r for r in self.cell.requests if r.get("ego_provenance") != "unknown"]
        return EgoPath(tuple(map(tuple, recorded_paths(known))))

    @property
    def ego_provenance(self) -> str:
        """How the recorded path is known: measured, declared or unknown."""
        return self.cell.facts.clip.ego

    @property
    def sees_ground(self) -> bool:
        """True where the camera's pose is known, so that a path can be drawn on the picture."""
        geometry = self.cell.facts.clip.geometry
        return (
            geometry is not None
            and geometry.height_m is not None
            and geometry.pitch_down_rad is not None
            and self.cell.facts.clip.mount_forward_m is not None
        )

    @property
    def start_ns(self) -> int:
        """Stamp of clip time 0."""
        told = self.cell.facts.clip.start_ns
        if told is not None:
            return told
        for moment in self.moments:
            if moment.stamp_ns is not None and moment.judgement.record_t_s is not None:
                return moment.stamp_ns - round(moment.judgement.record_t_s * NS_PER_S)
        return 0

    def drawn(self, path: Trajectory | None) -> Ribbon | None:
        """A path in the ego frame as the camera shows it."""
        clip = self.cell.facts.clip
        if path is None or clip.geometry is None:
            return None
        turn = (clip.mount_left_m, clip.mount_yaw_left_rad, clip.mount_roll_right_rad)
        return ribbon(path, clip.geometry.model_dump(), clip.mount_forward_m, turn)

    def recorded(self, at_ns: int) -> Trajectory | None:
        """What was driven from a time on."""
        return self.path.after(at_ns * NS, _HORIZON_S)

    def keeps(self, sha256: str) -> bool:
        """True for a frame that lies in the campaign, which keeps the newest of each request."""
        return frame_path(self.out, sha256).is_file()

    def picture(self, sha256: str) -> Image:
        """A frame that was sent, BGR, at the size that the camera's geometry is for.

        Raises:
            InputError: it isn't there or is no picture.
        """
        file = frame_path(self.out, sha256)
        try:
            data = np.frombuffer(file.read_bytes(), np.uint8)
        except OSError as error:
            raise InputError(f"can't be read: {error.strerror}", file=file) from error
        image = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
        if image is None:
            raise InputError("is no picture", file=file)
        return self.fitted(np.asarray(image, np.uint8))

    def fitted(self, image: Image) -> Image:
        """A frame at the size that the camera's geometry is for."""
        geometry = self.cell.facts.clip.geometry
        if geometry is not None and image.shape[:2] != (geometry.height_px, geometry.width_px):
            image = np.asarray(cv2.resize(image, (geometry.width_px, geometry.height_px)), np.uint8)
        return image


def overlay_of(
    cell: CellData, out: Path, recordings: Recordings | None = None
) -> CellOverlay | None:
    """The story of a cell; None unless it has scores.

    Args:
        recordings: of it; None: what the campaign keeps must do.
    """
    if cell.score is None:
        return None
    asked = cell.requests_by_label()
    story = CellOverlay(
        cell,
        out,
        tuple(
            _moment(cell, label, judgement, asked.get(label.t_s, {}))
            for label, judgement in zip(
                cell.labels.labels, cell.score.details.judgements, strict=True
            )
        ),
    )
    if recordings is None:
        return story
    first, last = cell.labels.labels[0].t_s, cell.labels.labels[-1].t_s
    found = recordings.find(
        cell,
        story.start_ns + seconds_to_ns(first),
        story.start_ns + seconds_to_ns(last),
    )
    if isinstance(found, str):
        return replace(story, lost=found)
    return replace(story, part=found)


def _moment(
    cell: CellData, label: Label, judgement: Judgement, request: Mapping[str, Any]
) -> Moment:
    record = None if judgement.record is None else cell.records[judgement.record]
    valid = record is not None and judgement.trajectory_valid
    stamp = request.get("stamp_ns")
    return Moment(
        label=label,
        judgement=judgement,
        stamp_ns=None if stamp is None else int(stamp),
        frames=tuple(
            (int(frame["stamp_ns"]), str(frame["sha256"])) for frame in request.get("frames", ())
        ),
        record=record,
        plan=record.trajectory if record is not None and valid else None,
    )
