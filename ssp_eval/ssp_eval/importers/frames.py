"""The frames of an import: each one is decoded and held against the others (METHOD 4.3b)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.bag.pictures.images import (
    check_depth,
    decode_still,
    is_mosaic,
    orientation_of,
    shown_size_px,
)
from ssp_core.bag.pictures.jpeg import UPRIGHT, JpegChecker
from ssp_core.cdr.images import JPEG_START, ImageMessage, read_image
from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.geometry import FloatArray
from ssp_eval.importers.findings import Finding, Findings
from ssp_eval.importers.target import jpeg
from ssp_eval.importers.tracks import MOVING_MPS, Track

# One picture may be shown for so long while the VUT drives; longer, the camera has stopped.
FROZEN_S = 0.3


@dataclass
class Repeats:
    """The runs of frames that show the same pixels."""

    _stamps_ns: list[int] = field(default_factory=list)
    _runs: list[list[int]] = field(default_factory=list)

    def take(self, stamp_ns: int, *, is_same: bool) -> None:
        """Take the next frame, which shows the same as the one before it, or doesn't."""
        if not is_same:
            self._end()
        self._stamps_ns.append(stamp_ns)

    def _end(self) -> None:
        if len(self._stamps_ns) > 1:
            self._runs.append(self._stamps_ns)
        self._stamps_ns = []

    def notes(self, speed_mps: Callable[[Sequence[int]], FloatArray], zero_ns: int) -> list[str]:
        """Name the pictures that are repeated while the VUT drives.

        Args:
            speed_mps: gives the VUT's speeds at stamps, which are on the clock of those taken.
            zero_ns: the first frame's time on that clock.
        """
        self._end()
        return [
            f"one picture {len(stamps)} times, from {ns_to_seconds(stamps[0] - zero_ns):.3f} to "
            f"{ns_to_seconds(stamps[-1] - zero_ns):.3f} s of the clip, while the VUT drives: did "
            "the camera stop?"
            for run in self._runs
            for stamps in _driving(run, np.abs(speed_mps(run)))
        ]


def speeds_of(track: Track) -> Callable[[Sequence[int]], FloatArray]:
    """Return the speeds of an object at any stamps on its clock."""
    samples = track.samples
    return lambda stamps_ns: np.interp(stamps_ns, samples.stamps_ns, samples["speed_mps"])


def _driving(stamps_ns: Sequence[int], speed_mps: FloatArray) -> Iterator[list[int]]:
    """Yield the parts of a run, longer than FROZEN_S, in which the VUT drives."""
    drives = np.concatenate([[False], speed_mps > MOVING_MPS, [False]])
    edges = np.flatnonzero(np.diff(drives.astype(int)))
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        part = list(stamps_ns[first:end])
        if part[-1] - part[0] > FROZEN_S * NS_PER_S:
            yield part


@dataclass(frozen=True)
class _Frame:
    """A frame as JPEG, and pixels by which it is compared with others: small ones, or its own."""

    jpeg: bytes
    pixels: NDArray[np.uint8]

    def shows_the_same_as(self, other: _Frame) -> bool:
        if self.jpeg == other.jpeg:
            return True
        if not np.array_equal(self.pixels, other.pixels):
            return False
        ours, theirs = (
            np.asarray(cv2.imdecode(np.frombuffer(one.jpeg, np.uint8), cv2.IMREAD_COLOR))
            for one in (self, other)
        )
        return np.array_equal(ours, theirs)


class FrameIntake:
    """Makes a JPEG of each frame of a topic, and finds those that can't be taken.

    Args:
        source: the bag.
        topic: of the camera.
        zero_ns: stamp of the first frame, for people.
        accepts_cut: damaged JPEGs are taken as far as they go.
        has_lens: a CameraInfo is asked for, which is of pictures before they are turned.
    """

    def __init__(
        self, source: Path, topic: str, zero_ns: int, *, accepts_cut: bool, has_lens: bool
    ) -> None:
        self._source, self._topic, self._zero_ns = source, topic, zero_ns
        self._accepts_cut, self._has_lens = accepts_cut, has_lens
        self._checker = JpegChecker()
        self._cut, self._unread = list[tuple[int, str]](), list[tuple[int, str]]()
        self._turned, self._mosaics, self._count = list[int](), 0, 0
        self.size_px = (0, 0)
        self.frame_id = ""
        self._last: _Frame | None = None
        self.repeats = Repeats()

    def take(self, stamp_ns: int, kind: str, data: bytes) -> bytes | None:
        """Give a frame as JPEG, the recorded bytes where they can stay; None: it is a finding."""
        self._count += 1
        try:
            image = read_image(kind, data)
            size_px = shown_size_px(image)
            if self._last is not None and size_px != self.size_px:
                turn = orientation_of(image)
                how = "" if turn == UPRIGHT else f" by its EXIF orientation {turn}"
                raise ValueError(
                    f"{size_px[0]}x{size_px[1]} px{how}, not {self.size_px[0]}x{self.size_px[1]} "
                    "as the first"
                )
            read = self._read(stamp_ns, image)
        except ValueError as error:
            self._unread.append((stamp_ns, str(error)))
            return None
        if read is None:
            return None
        self.size_px, self.frame_id = size_px, image.frame_id
        is_same = self._last is not None and read.shows_the_same_as(self._last)
        self.repeats.take(stamp_ns, is_same=is_same)
        self._last = read
        return read.jpeg

    def _read(self, stamp_ns: int, image: ImageMessage) -> _Frame | None:
        """Return the frame as JPEG and its pixels; None: it is cut off, and no one accepts that."""
        self._mosaics += is_mosaic(image)
        if image.layout is not None or image.data[:2] != JPEG_START:
            picture = decode_still(image)
            return _Frame(jpeg(picture), picture)
        check_depth(image)
        data = bytes(image.data)
        orientation = orientation_of(image)
        is_kept = orientation == UPRIGHT and not is_mosaic(image)
        if orientation != UPRIGHT:
            self._turned.append(orientation)
        try:
            small = self._checker.small(data)
        except ValueError as error:
            self._cut.append((stamp_ns, str(error)))
            if not self._accepts_cut:
                return None
            if not is_kept:
                raise
            picture = self._checker.patched(data)
            return _Frame(jpeg(picture), picture)
        return _Frame(data if is_kept else jpeg(decode_still(image)), small)

    @property
    def describes_lens(self) -> bool:
        """Tell whether a CameraInfo can describe the frames: they are shown as they are stored."""
        return not (self._turned and self._has_lens)

    def close(self, findings: Findings) -> list[str]:
        """Add what was found; give notes on what was converted."""
        notes = []
        if self._cut:
            at_s, why = self._first(self._cut)
            self._add(
                findings,
                "cut_pictures",
                f"{len(self._cut)} of {self._count} JPEGs are cut off or damaged, the first at "
                f"{at_s} of the clip: {why}",
                "cut the span out with --start and --end",
                acceptable=True,
            )
        if self._unread:
            at_s, why = self._first(self._unread)
            self._add(
                findings,
                "unread_pictures",
                f"holds a frame at {at_s} of the clip that can't be used: {why}"
                + (f" ({more} more such)" if (more := len(self._unread) - 1) else ""),
                "convert the pictures, or cut the span out with --start and --end",
            )
        if self._turned:
            number = self._turned[0]
            if self._has_lens:
                self._add(
                    findings,
                    "turned_pictures",
                    f"{len(self._turned)} of {self._count} JPEGs say EXIF orientation {number}: "
                    "the CameraInfo is of the pictures before they are turned",
                    "record upright pictures, or leave --camera-info out",
                )
            notes.append(
                f"{len(self._turned)} frames were turned upright: EXIF orientation {number}"
            )
        if self._mosaics:
            notes.append(f"{self._mosaics} frames are Bayer mosaics and were converted to colour")
        return notes

    def _first(self, occurrences: Sequence[tuple[int, str]]) -> tuple[str, str]:
        stamp_ns, why = occurrences[0]
        return f"{ns_to_seconds(stamp_ns - self._zero_ns):.3f} s", why

    def _add(
        self, findings: Findings, name: str, problem: str, remedy: str, *, acceptable: bool = False
    ) -> None:
        findings.add(
            Finding(name, problem, remedy, self._source, self._topic, acceptable=acceptable)
        )
