"""``ssp labels boxes``: where each object appears in each frame."""

from __future__ import annotations

import json
from pathlib import Path

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files import make_folder, write_text
from ssp_eval.labels.boxes import BOXES_SCHEMA, boxes_of_bag, boxes_of_truth
from ssp_eval.labels.footage import is_bag

_PATH = click.Path(path_type=Path)


@click.command()
@click.argument("source", metavar="BAG|TRUTH", type=_PATH)
@click.option("--out", type=_PATH, required=True, help="File to write (JSON lines).")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
def boxes(source: Path, out: Path, force: bool) -> None:
    """Writes ground-truth boxes of every frame: for audits and labels, never for a model.

    SOURCE is a simulated session's BAG, or the TRUTH file of a clip. The first line names schema
    and source; each other line is a frame with its clip time and the objects that it may show:
    id, class, box (left, top, right, bottom in px), distance, and the share that nothing hides.
    """
    if out.exists() and not force:
        raise InputError("exists already", file=out, remedy="give --force to overwrite it")
    with console.progress("boxes", None):
        frames = list(boxes_of_bag(source) if is_bag(source) else boxes_of_truth(source))
    lines = [json.dumps({"schema": BOXES_SCHEMA, "source": source.name, "frames": len(frames)})]
    lines += [json.dumps(frame.to_json()) for frame in frames]
    make_folder(out.parent)
    write_text(out, "\n".join(lines) + "\n")
    console.note(f"{out}: {len(frames)} frames, {sum(len(f.objects) for f in frames)} boxes")
