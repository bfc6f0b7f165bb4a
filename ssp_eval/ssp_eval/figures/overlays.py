"""Overlays of a campaign: annotated frames and a short video per cell, and phase-aligned frames."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from ssp_core.bag.frames import Picture
from ssp_core.bag.still_images import encode_jpeg, even_sized
from ssp_core.bag.video_file import VideoFile
from ssp_core.clock import NS_PER_S
from ssp_core.files import make_folder, write_bytes
from ssp_eval.figures.annotate import Annotation, annotated, wrapped
from ssp_eval.figures.moments import Image, Moment, Story, story_of
from ssp_eval.figures.phases import all_phase_frames
from ssp_eval.figures.scores import words
from ssp_eval.figures.write import Written, written_drawings
from ssp_eval.report.load import CellData, load_cells

FOLDER = "overlays"
VIDEO = "overlay.mp4"
# How long the last frame stays.
_HOLD_NS = NS_PER_S // 2


def write_overlays(
    campaign: Path,
    out: Path,
    progress: Callable[[str], None] = lambda name: None,
    cells: Sequence[CellData] | None = None,
) -> Written:
    """Writes the overlays of every cell with scores, and its phase-aligned frames.

    Args:
        campaign: folder of `ssp evaluate`.
        out: folder, made where it isn't there.
        progress: called with a name once it is written.
        cells: of the campaign, where they were loaded already.

    Raises:
        InputError: the campaign is damaged, or the folder can't be written.
    """
    stories, left_out = [], []
    for cell in load_cells(campaign) if cells is None else cells:
        story = story_of(cell, campaign)
        if story is None:
            left_out.append((f"{FOLDER}/{cell.id}", f"the cell is {cell.facts.status}"))
        else:
            stories.append(story)
    make_folder(out)
    files: list[Path] = []
    for story in stories:
        files += _write_cell(story, out / FOLDER / story.cell.id)
        progress(f"{FOLDER}/{story.cell.id}")
    phases = written_drawings(
        all_phase_frames([story for story in stories if not story.cell.is_control]), out, progress
    )
    return Written((*files, *phases.files), (*left_out, *phases.left_out))


def _write_cell(story: Story, folder: Path) -> list[Path]:
    make_folder(folder)
    files = []
    for number, moment in enumerate(story.moments, start=1):
        if not moment.frames:
            continue
        stamp_ns, sha256 = moment.frames[-1]
        image = _drawn(story, moment, stamp_ns, sha256)
        name = f"{number:02d}_{moment.label.phase}_{moment.label.t_s:.2f}s.jpg"
        write_bytes(folder / name, encode_jpeg(image))
        files.append(folder / name)
    video = _write_video(story, folder / VIDEO)
    return [*files, *([video] if video is not None else [])]


def video_frames(story: Story) -> list[tuple[int, str, Moment | None]]:
    """Stamp and hash of each frame that the campaign keeps, with the last moment by then."""
    sent: dict[int, str] = {}
    for moment in story.moments:
        sent.update((stamp, sha256) for stamp, sha256 in moment.frames if story.keeps(sha256))
    asked = [moment for moment in story.moments if moment.stamp_ns is not None]
    found = []
    for stamp_ns in sorted(sent):
        before = [m for m in asked if m.stamp_ns is not None and m.stamp_ns <= stamp_ns]
        found.append((stamp_ns, sent[stamp_ns], before[-1] if before else None))
    return found


def _write_video(story: Story, path: Path) -> Path | None:
    """The frames that are kept, at the times at which they were taken; None without any."""
    part = path.with_name(f".{path.name}")
    video: VideoFile | None = None
    try:
        for picture in _pictures(story):
            size = (picture.image.shape[1], picture.image.shape[0])
            if video is None:
                video = VideoFile(part, *size)
            if size == video.size_px:
                video.add(picture)
        if video is None:
            return None
        video.close()
        video = None
        os.replace(part, path)
        return path
    finally:
        if video is not None:
            video.close()
        part.unlink(missing_ok=True)


def _pictures(story: Story) -> Iterator[Picture]:
    last: Picture | None = None
    for stamp_ns, sha256, moment in video_frames(story):
        image = even_sized(_drawn(story, moment, stamp_ns, sha256))
        last = Picture(stamp_ns, stamp_ns, image)
        yield last
    if last is not None:
        held_ns = last.stamp_ns + _HOLD_NS
        yield Picture(held_ns, held_ns, last.image)


def _drawn(story: Story, moment: Moment | None, stamp_ns: int, sha256: str) -> Image:
    picture = story.picture(sha256)
    cell = story.cell
    title = f"{words(cell.scenario)} · {cell.domain} · {cell.model}"
    recorded = story.drawn(story.recorded(stamp_ns))
    at_s = (stamp_ns - _start_ns(story)) / NS_PER_S
    corner = f"{at_s:.2f} s"
    if moment is None:
        lines = [title, "before the first label", _known(story)]
        return annotated(picture, Annotation(None, recorded, corner, tuple(lines)))
    plan = None
    if moment.plan is not None and moment.stamp_ns is not None:
        seen = story.path.seen_from(moment.plan, moment.stamp_ns, stamp_ns)
        plan = None if seen is None else story.drawn(seen)
    actions = f"says {moment.says}   plans {moment.plans}   ok: {moment.allowed}"
    text = moment.record.text if moment.record is not None else "no answer"
    lines = [
        f"{title} · answer at {moment.label.t_s:g} s · {_known(story)}",
        actions,
        *wrapped(text or "no text", picture.shape[1], 2),
    ]
    return annotated(
        picture, Annotation(plan, recorded, f"{corner}  {moment.label.phase}", tuple(lines))
    )


def _start_ns(story: Story) -> int:
    """Stamp of clip time 0, from a label's own time and its request's."""
    for moment in story.moments:
        if moment.stamp_ns is not None and moment.judgement.record_t_s is not None:
            return moment.stamp_ns - round(moment.judgement.record_t_s * NS_PER_S)
    return 0


def _known(story: Story) -> str:
    """How the dashed line is known."""
    if not story.sees_ground:
        return "no paths: the camera's pose is unknown"
    if not story.path.pieces:
        return "driven path: unknown"
    return f"driven path (dashed): {story.ego_provenance}"
