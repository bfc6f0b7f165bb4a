"""Overlays of a campaign: annotated frames and a video per cell."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from matplotlib.font_manager import FontProperties, findfont, get_font
from numpy.typing import NDArray

from ssp_core.bag.frames import Picture, VideoFile
from ssp_core.bag.images import encode_jpeg, even_sized
from ssp_core.clock import NS_PER_S
from ssp_core.files import make_folder, write_bytes, write_text
from ssp_eval.data.ego_path import NS
from ssp_eval.evaluate.results import CellData
from ssp_eval.figures.moments import CellOverlay, Image, Moment, Recordings, overlay_of
from ssp_eval.figures.phases import MOST_CELLS
from ssp_eval.figures.projection import Ribbon
from ssp_eval.figures.scores import words
from ssp_eval.figures.style import FONT, INK, ORANGE, SKY, caption, drawable
from ssp_eval.figures.write import Written
from ssp_eval.score.cli import NULL
from ssp_eval.statistics.notices import stand_in_text, stand_ins

Color = tuple[int, int, int]

_LINES = 5
# Of the picture's width: height of the font, and from one line of text to the next.
_FONT_SHARE, _LINE_SHARE = 1 / 60, 1 / 42
_SHIFT = 4  # binary digits behind the point in OpenCV's coordinates
_FAR_PX = 20_000.0


@dataclass(frozen=True)
class Annotation:
    """What stands on and below one frame.

    Args:
        plan: the predicted trajectory, None: there is none to draw.
        recorded: the path that was driven, None: not known.
        corner: in the picture's upper left corner.
        lines: below the picture; those past the fifth are left out.
    """

    plan: Ribbon | None
    recorded: Ribbon | None
    corner: str
    lines: tuple[str, ...]


def _bgr(colour: str) -> Color:
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return blue, green, red


def annotated(picture: Image, what: Annotation) -> Image:
    """The picture with what belongs on it, and a strip with text below; the input stays as it is.

    Args:
        picture: BGR, of the size that the ribbons are in.
    """
    image = picture.copy()
    width = image.shape[1]
    thick = max(1, round(width / 320))
    if what.plan is not None:
        _surface(image, what.plan, thick)
    if what.recorded is not None:
        _dashes(image, what.recorded.middle, thick)
    if what.plan is not None:
        for spot in what.plan.dots:
            for radius, colour in ((1.6 * thick + 1, _bgr(INK)), (1.6 * thick, (255, 255, 255))):
                centre = _fixed([spot])[0]
                cv2.circle(
                    image, (int(centre[0]), int(centre[1])), round(radius * (1 << _SHIFT)), colour,
                    -1, cv2.LINE_AA, _SHIFT,
                )  # fmt: skip
    font_px, line_px = max(9, round(width * _FONT_SHARE)), max(12, round(width * _LINE_SHARE))
    strip = np.full((line_px * _LINES + line_px // 2, width, 3), 255, np.uint8)
    margin = max(2, width // 120)
    for number, line in enumerate(what.lines[:_LINES]):
        _write(strip, line, (margin, line_px * (number + 1)), font_px, _bgr(INK))
    box = _mask(what.corner, font_px)[0].shape[1] + 2 * margin
    image[: line_px + margin, : min(box, width)] = 255
    _write(image, what.corner, (margin, line_px), font_px, _bgr(INK))
    return np.vstack([image, strip])


def _fixed(points: Sequence[tuple[float, float]]) -> NDArray[np.int32]:
    """Points as OpenCV's whole numbers; what lies far outside is moved nearer."""
    limited = np.clip(np.asarray(points, np.float64), -_FAR_PX, _FAR_PX)
    return np.asarray(np.round(limited * (1 << _SHIFT)), np.int32)


def _surface(image: Image, plan: Ribbon, thick: int) -> None:
    if len(plan.middle) < 2:
        return
    outline = _fixed(plan.outline)
    over = image.copy()
    cv2.fillPoly(over, [outline], _bgr(SKY), cv2.LINE_AA, _SHIFT)
    cv2.addWeighted(over, 0.45, image, 0.55, 0.0, dst=image)
    cv2.polylines(image, [outline], True, (255, 255, 255), max(1, thick // 2), cv2.LINE_AA, _SHIFT)


def _dashes(image: Image, middle: Sequence[tuple[float, float]], thick: int) -> None:
    """A dashed line with a dark border, dashes of equal length in the picture."""
    points = np.clip(np.asarray(middle, np.float64), -_FAR_PX, _FAR_PX)
    if len(points) < 2:
        return
    lengths = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    dash = 5.0 * thick
    for start in np.arange(0.0, lengths[-1], 1.7 * dash):
        along = np.linspace(start, min(start + dash, lengths[-1]), 4)
        piece = np.stack([np.interp(along, lengths, points[:, k]) for k in (0, 1)], axis=1)
        ends = _fixed([(float(x), float(y)) for x, y in piece])
        for colour, width in ((_bgr(INK), thick + 2), (_bgr(ORANGE), thick)):
            cv2.polylines(image, [ends], False, colour, width, cv2.LINE_AA, _SHIFT)


@lru_cache(maxsize=512)
def _mask(text: str, size_px: int) -> tuple[NDArray[np.uint8], int]:
    """A line of text as coverage 0 to 255, and how many of its rows lie below the baseline."""
    font = get_font(findfont(FontProperties(family=FONT), fallback_to_default=False))
    font.clear()
    font.set_size(size_px, 72)
    font.set_text(drawable(text) or " ", 0.0)
    font.draw_glyphs_to_bitmap(antialiased=True)
    return np.array(font.get_image(), np.uint8), round(font.get_descent() / 64)


def _write(image: Image, text: str, baseline: tuple[int, int], size_px: int, colour: Color) -> None:
    """Text on a picture; what doesn't fit is cut off at its border."""
    mask, below = _mask(text, size_px)
    left, top = baseline[0], baseline[1] + below - mask.shape[0]
    first = max(0, -top)
    rows = min(mask.shape[0], image.shape[0] - top)
    columns = min(mask.shape[1], image.shape[1] - left)
    if rows <= first or columns <= 0:
        return
    share = mask[first:rows, :columns, None].astype(np.float64) / 255.0
    part = image[top + first : top + rows, left : left + columns]
    part[:] = np.round(part * (1.0 - share) + np.array(colour) * share).astype(np.uint8)


def wrapped(text: str, width_px: int, lines: int) -> list[str]:
    """Text in lines that fit below a picture of this width; the last one ends in an ellipsis.

    Args:
        text: of a model; line breaks count as spaces.
    """
    size_px = max(9, round(width_px * _FONT_SHARE))
    room = width_px - 2 * max(2, width_px // 120)
    found: list[str] = []
    line = ""
    for word in text.split():
        longer = f"{line} {word}" if line else word
        if line and _mask(longer, size_px)[0].shape[1] > room:
            found.append(line)
            longer = word
        line = longer
        if len(found) == lines:
            break
    if line and len(found) < lines:
        return [*found, line]
    if found and line:
        last = found[-1]
        while last and _mask(f"{last}…", size_px)[0].shape[1] > room:
            last = last[:-1]
        found[-1] = f"{last}…"
    return found


# How long the last frame stays.
_HOLD_NS = NS_PER_S // 2


def latest(story: CellOverlay, stamp_ns: int) -> Moment | None:
    """The last moment that was asked about by then."""
    asked = [m for m in story.moments if m.stamp_ns is not None and m.stamp_ns <= stamp_ns]
    return max(asked, key=lambda m: m.stamp_ns or 0, default=None)


def drawn(story: CellOverlay, moment: Moment | None, stamp_ns: int, picture: Image) -> Image:
    """A frame with the plan of a moment, the driven path, and words.

    Args:
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
        seen = story.path.seen_from(moment.plan, moment.stamp_ns * NS, stamp_ns * NS)
        plan = None if seen is None else story.drawn(seen)
    failure = moment.judgement.first_failure
    text = moment.record.text if moment.record is not None else "no answer"
    lines = [
        f"{title} · answer at {moment.label.t_s:.2f} s · {_known(story)}",
        f"says {moment.says}   plans {moment.plans}   ok: {moment.allowed}",
        f"first failure: {NULL if failure is None else words(failure)}",
        *wrapped(text or "no text", picture.shape[1], 2),
    ]
    return annotated(
        picture, Annotation(plan, recorded, f"{corner}  {moment.label.phase}", tuple(lines))
    )


def _known(story: CellOverlay) -> str:
    """How the dashed line is known."""
    if not story.sees_ground:
        return "no paths: the camera's pose is unknown"
    if not story.path.pieces:
        return "driven path: unknown"
    return f"driven path (dashed): {story.ego_provenance}"


def kept_frames(story: CellOverlay) -> list[tuple[int, str]]:
    """Stamp and hash of each frame that the campaign keeps, in order."""
    sent: dict[int, str] = {}
    for moment in story.moments:
        sent.update((stamp, sha256) for stamp, sha256 in moment.frames if story.keeps(sha256))
    return sorted(sent.items())


def _source(story: CellOverlay) -> Iterator[tuple[int, Image]]:
    if story.part is None:
        for stamp_ns, sha256 in kept_frames(story):
            yield stamp_ns, story.picture(sha256)
        return
    for picture in story.part.pictures():
        yield picture.stamp_ns, story.fitted(picture.image)


def _pictures(story: CellOverlay) -> Iterator[Picture]:
    last: Picture | None = None
    for stamp_ns, image in _source(story):
        shown = drawn(story, latest(story, stamp_ns), stamp_ns, image)
        last = Picture(stamp_ns, stamp_ns, even_sized(shown))
        yield last
    if last is not None:
        held_ns = last.stamp_ns + _HOLD_NS
        yield Picture(held_ns, held_ns, last.image)


def write_video(story: CellOverlay, path: Path) -> Path | None:
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


def video_caption(story: CellOverlay) -> str:
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


FOLDER = "overlays"
VIDEO, CAPTION = "overlay.mp4", "overlay.txt"


def write_overlays(
    campaign: Path,
    out: Path,
    cells: Sequence[CellData],
    progress: Callable[[str], None] = lambda name: None,
    limit: bool = False,
) -> Written:
    """Writes an annotated frame per label and a video of each model's cell with scores.

    Args:
        limit: leave them all out where they are of more than MOST_CELLS cells.

    Raises:
        InputError: a frame isn't as the campaign left it, or the folder can't be written.
    """
    wanted = [cell for cell in cells if not cell.is_control and cell.score is not None]
    if limit and len(wanted) > MOST_CELLS:
        why = f"{len(wanted)} cells take minutes; ask for them with --only {FOLDER}"
        return Written((), ((FOLDER, why),))
    recordings = Recordings(campaign)
    files: list[Path] = []
    lost: dict[str, None] = {}
    for cell in wanted:
        story = overlay_of(cell, campaign, recordings)
        if story is not None:
            files += _write_cell(story, out / FOLDER / cell.id)
            lost |= dict.fromkeys([story.lost] if story.lost else [])
            progress(f"{FOLDER}/{cell.id}")
    left_out = [(f"{FOLDER}: every frame", f"kept frames alone: {why}") for why in lost]
    return Written(tuple(files), tuple(left_out))


def _write_cell(story: CellOverlay, folder: Path) -> list[Path]:
    make_folder(folder)
    files = []
    for number, moment in enumerate(story.moments, start=1):
        if moment.frames:
            files.append(_write_still(story, number, moment, folder))
    video = write_video(story, folder / VIDEO)
    files += [video] if video is not None else []
    write_text(folder / CAPTION, video_caption(story))
    return [*files, folder / CAPTION]


def _write_still(story: CellOverlay, number: int, moment: Moment, folder: Path) -> Path:
    stamp_ns, sha256 = moment.frames[-1]
    image = drawn(story, moment, stamp_ns, story.picture(sha256))
    path = folder / f"{number:02d}_{moment.label.phase}_{moment.label.t_s:.2f}s.jpg"
    write_bytes(path, encode_jpeg(image))
    return path
