"""Overlays of a campaign: annotated frames and a video per cell, and phase-aligned frames."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ssp_core import __version__
from ssp_core.bag.images import encode_jpeg
from ssp_core.errors import InputError
from ssp_core.files import make_folder, read_text, write_bytes, write_json, write_text
from ssp_core.hashing import sha256_file, sha256_json
from ssp_eval.figures.moments import Moment, Story, story_of
from ssp_eval.figures.overlay_video import drawn, video_caption, write_video
from ssp_eval.figures.phases import all_phase_frames
from ssp_eval.figures.recording import Recordings
from ssp_eval.figures.write import Written, written_drawings
from ssp_eval.report.load import CellData, load_cells

FOLDER = "overlays"
VIDEO, CAPTION, MADE = "overlay.mp4", "overlay.txt", "overlay.json"
MADE_SCHEMA = "ssp.overlay/1"
# Another number makes every overlay anew: it changes with what is drawn.
_DRAWING = 2


def write_overlays(
    campaign: Path,
    out: Path,
    progress: Callable[[str], None] = lambda name: None,
    cells: Sequence[CellData] | None = None,
) -> Written:
    """Writes the overlays of every model's cell with scores, and its phase-aligned frames.

    Overlays that an earlier run made of the same cell and recording are left as they are.

    Args:
        campaign: folder of `ssp evaluate`.
        out: folder, made where it isn't there.
        progress: called with a name once it is written.
        cells: of the campaign, where they were loaded already.

    Raises:
        InputError: the campaign is damaged, or the folder can't be written.
    """
    recordings = Recordings(campaign)
    stories: list[Story] = []
    left_out: list[tuple[str, str]] = []
    controls = 0
    for cell in load_cells(campaign) if cells is None else cells:
        if cell.is_control:
            controls += 1
        elif (story := story_of(cell, campaign, recordings)) is None:
            left_out.append((f"{FOLDER}/{cell.id}", f"the cell is {cell.facts.status}"))
        else:
            stories.append(story)
    if controls:
        why = f"{controls} cells of controls check the harness and show no model"
        left_out.append((FOLDER, why))
    make_folder(out)
    files: list[Path] = []
    for story in stories:
        files += _write_cell(story, out / FOLDER / story.cell.id)
        progress(f"{FOLDER}/{story.cell.id}")
    if lost := sorted({story.lost for story in stories if story.lost}):
        count = sum(bool(story.lost) for story in stories)
        why = f"{count} videos show kept frames alone: {'; '.join(lost)}"
        left_out.append((f"{FOLDER}: every frame", why))
    phases = written_drawings(all_phase_frames(stories), out, progress)
    return Written((*files, *phases.files), (*left_out, *phases.left_out))


def _inputs(story: Story) -> str:
    """Hash of all that a cell's overlays depend on."""
    facts = story.cell.facts.model_dump(mode="json", by_alias=True)
    # How the cell came about tells nothing that is drawn.
    facts.pop("answers")
    source = story.lost if story.part is None else list(story.part.stamps_ns)
    return sha256_json([_DRAWING, __version__, facts, source])


def _made(folder: Path, inputs: str) -> list[Path] | None:
    """The files of an earlier run of the same inputs, if all of them are there and whole."""
    try:
        value: Any = json.loads(read_text(folder / MADE))
        if value["schema"] != MADE_SCHEMA or value["inputs"] != inputs:
            return None
        files = {folder / str(name): str(digest) for name, digest in value["files"].items()}
        if any(sha256_file(file) != digest for file, digest in files.items()):
            return None
    except (InputError, OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return [*files, folder / MADE]


def _write_cell(story: Story, folder: Path) -> list[Path]:
    inputs = _inputs(story)
    if (made := _made(folder, inputs)) is not None:
        return made
    make_folder(folder)
    (folder / MADE).unlink(missing_ok=True)
    files = []
    for number, moment in enumerate(story.moments, start=1):
        if moment.frames:
            files.append(_write_still(story, number, moment, folder))
    video = write_video(story, folder / VIDEO)
    files += [video] if video is not None else []
    write_text(folder / CAPTION, video_caption(story))
    files.append(folder / CAPTION)
    # Last, so that an interrupted run leaves none.
    hashes = {file.name: sha256_file(file) for file in files}
    write_json(folder / MADE, {"schema": MADE_SCHEMA, "inputs": inputs, "files": hashes})
    return [*files, folder / MADE]


def _write_still(story: Story, number: int, moment: Moment, folder: Path) -> Path:
    stamp_ns, sha256 = moment.frames[-1]
    image = drawn(story, moment, stamp_ns, story.picture(sha256))
    path = folder / f"{number:02d}_{moment.label.phase}_{moment.label.t_s:.2f}s.jpg"
    write_bytes(path, encode_jpeg(image))
    return path
