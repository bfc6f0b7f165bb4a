"""Ground-truth boxes: where each object appears in each frame, for audits and labels only."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from ssp_core import console
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import object_state, peek_stamp_ns
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder
from ssp_core.files.reading import parse_model, read_mapping
from ssp_core.files.writing import write_text
from ssp_core.motion.state import ObjectState
from ssp_core.names import CAMERA_IMAGE, WORLD_TICK, absolute
from ssp_core.run_file.model import Camera
from ssp_core.world.camera import View, shown_box, view_from
from ssp_eval.data.provenance import read_provenance
from ssp_eval.labels.truth import is_bag, truth_from_file
from ssp_eval.recordings.clip import Clip
from ssp_eval.recordings.sight import clear_share

# Without these nobody knows what a picture shows; the others have harmless defaults.
_NEEDED = ("width_px", "height_px", "hfov_deg", "forward_m", "height_m", "pitch_down_rad")
BOXES_SCHEMA = "ssp.boxes/1"


@dataclass(frozen=True)
class ObjectBox:
    """One object in one frame.

    Args:
        object_id, object_class: which; the class as a word.
        box_px: left, top, right, bottom of what lies in the image.
        distance_m: from the camera to the object's reference point, on the ground.
        clear_share: share of points round the object that no other object hides.
    """

    object_id: str
    object_class: str
    box_px: tuple[float, float, float, float]
    distance_m: float
    clear_share: float


@dataclass(frozen=True)
class BoxedFrame:
    """All objects that a frame may show, nearest first; ``t_s`` is its clip time."""

    t_s: float
    objects: tuple[ObjectBox, ...]

    def to_json(self) -> dict[str, Any]:
        """Return one line of the file."""
        return {
            "t_s": round(self.t_s, 6),
            "objects": [
                {
                    "object_id": o.object_id,
                    "object_class": o.object_class,
                    "box_px": [round(x, 2) for x in o.box_px],
                    "distance_m": round(o.distance_m, 3),
                    "clear_share": round(o.clear_share, 3),
                }
                for o in self.objects
            ],
        }


def boxes(view: View, states: Iterable[ObjectState], vut_id: str) -> tuple[ObjectBox, ...]:
    """Return the objects of which a view holds something and which aren't hidden, nearest first.

    Args:
        view: of the VUT's camera, frame map.
        states: of all objects, the VUT's too.
        vut_id: who carries the camera and isn't in its own picture.
    """
    others = [s for s in states if s.object_id != vut_id]
    object_boxes = []
    for state in others:
        box = shown_box(view, state)
        if box is None:
            continue
        rest = [s for s in others if s is not state]
        clear = clear_share(view.position_m, state, rest)
        if clear > 0.0:
            away = np.hypot(state.x_m - view.position_m[0], state.y_m - view.position_m[1])
            object_boxes.append(
                ObjectBox(state.object_id, state.object_class.word, box, float(away), clear)
            )
    return tuple(sorted(object_boxes, key=lambda o: (o.distance_m, o.object_id)))


def _series(
    moments: Iterable[tuple[float, Iterable[ObjectState]]],
    vut_id: str,
    camera: Callable[[ObjectState], View],
) -> Iterator[BoxedFrame]:
    for t_s, states in moments:
        present: Mapping[str, ObjectState] = {s.object_id: s for s in states}
        if vut_id in present:
            view = camera(present[vut_id])
            yield BoxedFrame(t_s, boxes(view, present.values(), vut_id))


def boxes_of_bag(path: Path) -> Iterator[BoxedFrame]:
    """Yield the frames of a recorded session, in order.

    Raises:
        InputError: it is no session's bag, or holds no camera, frames or ground truth.
    """
    with Clip(path) as clip:
        optics, start_ns = clip.optics, clip.start_ns
    if optics is None:
        raise InputError(
            "doesn't say where its camera sits",
            file=path,
            remedy="give a recording with its camera's place, or import it with one",
        )
    with BagReader(path) as bag:
        run = read_provenance(bag).run
        if run is None or absolute(WORLD_TICK) not in bag.topics:
            raise InputError(
                "holds no ground truth", file=path, remedy="give a simulated session's bag"
            )
        stamps = {peek_stamp_ns(m.data) for m in bag.messages([absolute(CAMERA_IMAGE)])}

        def moments() -> Iterator[tuple[float, list[ObjectState]]]:
            last = None
            for message in bag.messages([absolute(WORLD_TICK)]):
                stamp = peek_stamp_ns(message.data)
                # While the world holds, its tick comes again and again.
                if stamp in stamps and stamp != last:
                    last = stamp
                    objects = [object_state(o) for o in bag.decode(message).objects]
                    yield ns_to_seconds(stamp - start_ns), objects

        yield from _series(moments(), run.vut.id, lambda vut: optics.view(vut.pose))


def boxes_of_truth(path: Path) -> Iterator[BoxedFrame]:
    """Yield the frames of a clip, from its truth file.

    Raises:
        InputError: it is no truth file, or doesn't state its camera.
    """
    truth = truth_from_file(path)
    stated = read_mapping(path).get("camera")
    missing = [name for name in _NEEDED if not isinstance(stated, dict) or name not in stated]
    if missing or not isinstance(stated, dict):
        raise InputError(
            "doesn't state its camera in full",
            file=path,
            field=f"camera.{missing[0]}",
            remedy=f"state {', '.join(missing)}",
        )
    fields = {key: value for key, value in stated.items() if key in Camera.model_fields}
    camera = parse_model(Camera, fields, path)
    series = ((t_s, list(now.values())) for t_s, now in truth.states)
    yield from _series(series, truth.vut_id, lambda vut: view_from(vut.pose, camera))


_PATH = click.Path(path_type=Path)


@click.command()
@click.argument("source", metavar="BAG|TRUTH", type=_PATH)
@click.option("--out", type=_PATH, required=True, help="File to write (JSON lines).")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
def boxes_command(source: Path, out: Path, force: bool) -> None:
    """Write ground-truth boxes of every frame: for audits and labels, never for a model.

    BAG is that of a simulated session, TRUTH the file of a clip. The first line names schema
    and source; each other line is a frame with its clip time and the objects that it may show:
    id, class, box (left, top, right, bottom in px), distance, and its unoccluded share.
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
