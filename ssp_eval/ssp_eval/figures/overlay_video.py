"""The video of a cell: every recorded frame, with the plan of the latest answer until the next."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from ssp_core.bag.frames import Picture, VideoFile
from ssp_core.bag.images import even_sized
from ssp_core.clock import NS_PER_S
from ssp_eval.analysis.notices import stand_in_text, stand_ins
from ssp_eval.figures.annotate import Annotation, annotated, wrapped
from ssp_eval.figures.drawing import caption
from ssp_eval.figures.moments import Image, Moment, Story
from ssp_eval.figures.scores import words
from ssp_eval.score.show import NULL

# How long the last frame stays.
_HOLD_NS = NS_PER_S // 2


def latest(story: Story, stamp_ns: int) -> Moment | None:
    """The last moment that was asked about by then."""
    asked = [m for m in story.moments if m.stamp_ns is not None and m.stamp_ns <= stamp_ns]
    return max(asked, key=lambda m: m.stamp_ns or 0, default=None)


def drawn(story: Story, moment: Moment | None, stamp_ns: int, picture: Image) -> Image:
    """A frame with the plan of a moment, the driven path, and words.

    Args:
        story: of the cell.
        moment: whose answer is shown; None: there is none yet.
        stamp_ns: of the frame; the plan is drawn where it was planned, seen from now.
        picture: BGR, at the size that the camera's geometry is for.
    """
    cell = story.cell
    title = f"{words(cell.scenario)} · {cell.domain} · {cell.model}"
    recorded = story.drawn(story.recorded(stamp_ns))
    corner = f"{(stamp_ns - story.start_ns) / NS_PER_S:.2f} s"
    if moment is None:
        lines = [title, "before the first label", _known(story)]
        return annotated(picture, Annotation(None, recorded, corner, tuple(lines)))
    plan = None
    if moment.plan is not None and moment.stamp_ns is not None:
        seen = story.path.seen_from(moment.plan, moment.stamp_ns, stamp_ns)
        plan = None if seen is None else story.drawn(seen)
    failure = moment.judgement.first_failure
    text = moment.record.text if moment.record is not None else "no answer"
    lines = [
        f"{title} · answer at {moment.label.t_s:g} s · {_known(story)}",
        f"says {moment.says}   plans {moment.plans}   ok: {moment.allowed}",
        f"first failure: {NULL if failure is None else words(failure)}",
        *wrapped(text or "no text", picture.shape[1], 2),
    ]
    return annotated(
        picture, Annotation(plan, recorded, f"{corner}  {moment.label.phase}", tuple(lines))
    )


def _known(story: Story) -> str:
    """How the dashed line is known."""
    if not story.sees_ground:
        return "no paths: the camera's pose is unknown"
    if not story.path.pieces:
        return "driven path: unknown"
    return f"driven path (dashed): {story.ego_provenance}"


def kept_frames(story: Story) -> list[tuple[int, str]]:
    """Stamp and hash of each frame that the campaign keeps, in order."""
    sent: dict[int, str] = {}
    for moment in story.moments:
        sent.update((stamp, sha256) for stamp, sha256 in moment.frames if story.keeps(sha256))
    return sorted(sent.items())


def _source(story: Story) -> Iterator[tuple[int, Image]]:
    if story.part is None:
        for stamp_ns, sha256 in kept_frames(story):
            yield stamp_ns, story.picture(sha256)
        return
    for picture in story.part.pictures():
        yield picture.stamp_ns, story.fitted(picture.image)


def _pictures(story: Story) -> Iterator[Picture]:
    last: Picture | None = None
    for stamp_ns, image in _source(story):
        shown = drawn(story, latest(story, stamp_ns), stamp_ns, image)
        last = Picture(stamp_ns, stamp_ns, even_sized(shown))
        yield last
    if last is not None:
        held_ns = last.stamp_ns + _HOLD_NS
        yield Picture(held_ns, held_ns, last.image)


def write_video(story: Story, path: Path) -> Path | None:
    """The frames at the times at which they were taken; None without any.

    One frame is in memory at a time, and a file that isn't finished never has the video's name.
    """
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


def video_caption(story: Story) -> str:
    """What belongs under the video: which frames it shows, and how paths are known."""
    cell = story.cell
    if story.part is not None:
        frames = (
            f"All {len(story.part.stamps_ns)} frames of the recording between first and last label "
            f"({story.part.rate_hz:.0f} a second; of a faster camera as many as 20)."
        )
    else:
        frames = (
            f"Only the {len(kept_frames(story))} frames that the campaign keeps, the newest of "
            f"each question, since {story.lost or 'the recording was not looked for'}."
        )
    told = "from the recording" if story.part is not None else "as far as later requests tell it"
    path = (
        f"the dashed line is the path that was driven in the next 3 s ({story.ego_provenance}; "
        f"{told})"
        if story.path.pieces
        else "the path that was driven isn't known"
    )
    return caption(
        f"{words(cell.scenario)}, {cell.domain}, {cell.model}.",
        stand_in_text(stand_ins([cell.facts])),
        frames,
        "The ribbon is what the VUT would cover on the plan of the latest answer, seen from where "
        f"it is now, with a dot every 0.5 s of the plan; {path}."
        if story.sees_ground
        else "Without a known pose of the camera there are no paths.",
        "Below: what the text says, what the trajectory makes, what is allowed, and the first "
        "failure of METHOD 6.12. All was drawn after the fact and was in no input of a model.",
        composite=False,
    )
