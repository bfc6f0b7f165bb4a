"""Grey frames of a recording with the states at their times, and pairs of them to compare."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.bag.pictures.frames import Frames
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.names import CAMERA_IMAGE, absolute
from ssp_core.world.camera import Intrinsics, View
from ssp_eval.data.provenance import Provenance
from ssp_eval.recordings.sight import Moment, Optics
from ssp_eval.recordings.states import clip_zero_ns

Grey = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Item = TypeVar("Item")

# Pictures are compared at this width, or at their own where that is smaller.
WIDTH_PX = 640
_COARSE_PX = 80
_SAME_S = 1e-6
_IMAGE = absolute(CAMERA_IMAGE)


@dataclass(frozen=True)
class Footage:
    """Frames of a recording, reduced, with the states at their times.

    Args:
        moments: all frames' clip times and states, times rising.
        grey: pictures by index into ``moments``, all of one size.
        optics: of the recorded pictures.
        vut_id: whose camera it is.
    """

    moments: Sequence[Moment]
    grey: Mapping[int, Grey]
    optics: Optics
    vut_id: str

    @property
    def lens(self) -> Intrinsics:
        """The pinhole numbers of the reduced pictures."""
        return reduced_lens(self.optics.lens, next(iter(self.grey.values())))

    def view(self, index: int) -> View:
        """Return the camera at a frame, with the pinhole numbers of the reduced pictures."""
        optics = replace(self.optics, lens=self.lens)
        return optics.view(self.moments[index].states[self.vut_id].pose)


def reduced_lens(lens: Intrinsics, picture: Grey) -> Intrinsics:
    """Return the pinhole numbers of a picture that was scaled to another size."""
    height, width = picture.shape
    across, down = width / lens.width_px, height / lens.height_px
    return Intrinsics(
        width,
        height,
        lens.fx_px * across,
        lens.fy_px * down,
        (lens.cx_px + 0.5) * across - 0.5,
        (lens.cy_px + 0.5) * down - 0.5,
    )


def coarse(picture: Grey) -> Float32:
    """Return a small picture, in which noise is averaged out."""
    height, width = picture.shape
    size = (_COARSE_PX, max(1, round(height * _COARSE_PX / width)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)


def reduced_size(width_px: int, height_px: int) -> tuple[int, int]:
    """Return the width and height at which pictures of a size are compared."""
    if width_px <= WIDTH_PX:
        return width_px, height_px
    return WIDTH_PX, round(height_px * WIDTH_PX / width_px)


def reduced(picture: Grey) -> Grey:
    """Return a grey picture no wider than WIDTH_PX."""
    height, width = picture.shape
    size = reduced_size(width, height)
    if size == (width, height):
        return picture
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def pairs_apart(
    times_s: Sequence[float], apart_s: float, most: int, usable: Collection[int]
) -> list[tuple[int, int]]:
    """Choose pairs of frames that lie some time apart, spread evenly over the recording.

    Args:
        times_s: rising.
        apart_s: a pair is at least 0.02 s less, and at most 0.15 s more apart.
        most: pairs.
        usable: indices that may be in a pair.

    Returns:
        Pairs of indices, the earlier frame first.
    """
    pairs = []
    indices = sorted(usable)
    chosen_s = [times_s[index] for index in indices]
    for first, first_s in zip(indices, chosen_s, strict=True):
        place = bisect_left(chosen_s, first_s + apart_s - 0.02)
        if place < len(indices) and chosen_s[place] - first_s <= apart_s + 0.15:
            pairs.append((first, indices[place]))
    return spread(pairs, most)


def spread(items: Sequence[Item], most: int) -> list[Item]:
    """Return at most so many items, evenly spread over all."""
    if len(items) <= most:
        return list(items)
    return [items[round(k * (len(items) - 1) / (most - 1))] for k in range(most)]


def read_grey(
    path: Path, moments: Sequence[Moment], provenance: Provenance, indices: Collection[int]
) -> dict[int, Grey]:
    """Read frames of a bag as reduced grey pictures.

    Args:
        path: folder or MCAP file of the bag.
        moments: of its frames.
        provenance: of the recording.
        indices: into ``moments``.

    Raises:
        InputError: a frame is no picture.
    """
    frames = _read(path, moments, provenance, indices, cv2.IMREAD_GRAYSCALE)
    return {index: reduced(grey) for index, grey in frames}


def read_quarter(
    path: Path, moments: Sequence[Moment], provenance: Provenance, indices: Collection[int]
) -> dict[int, Grey]:
    """Read frames of a bag as grey pictures of a quarter of their width; see read_grey."""
    return dict(_read(path, moments, provenance, indices, cv2.IMREAD_REDUCED_GRAYSCALE_4))


def read_small(
    path: Path, moments: Sequence[Moment], provenance: Provenance, indices: Collection[int]
) -> dict[int, Float32]:
    """Read frames of a bag as small pictures, which costs less; see read_grey."""
    frames = _read(path, moments, provenance, indices, cv2.IMREAD_REDUCED_GRAYSCALE_4)
    return {index: coarse(grey) for index, grey in frames}


def _read(
    path: Path,
    moments: Sequence[Moment],
    provenance: Provenance,
    indices: Collection[int],
    mode: int,
) -> Iterator[tuple[int, Grey]]:
    """Yield indices and pictures of frames, decoded in a mode of cv2; each index once."""
    times_s = [moment.t_s for moment in moments]
    with BagReader(path) as bag:
        stamps_ns = sorted(peek_stamp_ns(message.data) for message in bag.messages([_IMAGE]))
        zero_ns = clip_zero_ns(provenance, stamps_ns)
        if zero_ns is None:
            return
        index_of: dict[int, int] = {}
        for stamp_ns in stamps_ns:
            t_s = ns_to_seconds(stamp_ns - zero_ns)
            index = bisect_left(times_s, t_s - _SAME_S)
            if index in indices and abs(times_s[index] - t_s) <= _SAME_S:
                index_of.setdefault(stamp_ns, index)
        if index_of:
            for frame in Frames(bag, _IMAGE).jpegs(stamps=frozenset(index_of)):
                if frame.stamp_ns not in index_of:  # given already
                    continue
                index = index_of.pop(frame.stamp_ns)
                grey = cv2.imdecode(np.frombuffer(frame.data, np.uint8), mode)
                if grey is None:
                    raise InputError(
                        f"holds a frame at {frame.log_time_ns} ns that is no picture",
                        file=path,
                        field=_IMAGE,
                        remedy="give a recording whose frames can be decoded",
                    )
                yield index, np.asarray(grey, np.uint8)
