"""``ssp draw``: the pictures of a finished recording, drawn anew by CARLA from its states."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import click

from ssp_core import __version__, console
from ssp_core.bag.reading.reader import BagReader
from ssp_core.carla.acceptance import opendrive_sha256, read_map
from ssp_core.carla.address import SCHEME, CarlaAddress, parse_address
from ssp_core.carla.record import CarlaScene
from ssp_core.errors import InputError, PeerError
from ssp_core.files.folders import taken_folder
from ssp_core.files.reading import parse_model
from ssp_core.hashing import sha256_file
from ssp_eval.data.drawn import DRAWN_ATTACHMENT, Redrawing
from ssp_eval.data.provenance import bag_folder, find_bag, read_provenance
from ssp_eval.draw.bag import write_redrawing
from ssp_eval.draw.pictures import Pictures
from ssp_eval.draw.scenes import DrawableRecording, read_recorded, scenes
from ssp_eval.recordings.states import attached
from ssp_ot_controller.camera.carla_painter import CarlaPainter
from ssp_ot_controller.camera.frames import jpeg
from ssp_scenario_manager.compile.task import TASK_FILE, TASK_FOLDER, Task


@click.command("draw")
@click.argument("recording", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--camera",
    "camera_text",
    required=True,
    metavar="carla://HOST[:PORT]",
    help="The CARLA server that draws (docs/carla.md).",
)
@click.option(
    "--map",
    "map_file",
    type=click.Path(path_type=Path),
    help="The server's map as OpenDRIVE, in the frame map of the recording. [default: the map that "
    "the run was compiled for, in its folder]",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="New folder of the bag; an interrupted drawing is resumed.  [default: out/draw-… with "
    "the name of RUN]",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def draw(
    recording: Path, camera_text: str, map_file: Path | None, out: Path | None, as_json: bool
) -> int:
    """Draw the pictures of a finished recording anew, from its states.

    RUN is the folder of a session, or its bag, simulated or on a track, here or from another host.
    The new bag holds the same messages with the same times, but for the pictures, and names the
    recording by its hash. Nothing is simulated, no ROS node is started, and no deadline has to be
    met. Finished pictures are kept in OUT.drawing: an interrupted command, given again, draws the
    rest. Both bags show the same drive, and are never two domains of one comparison.
    """
    if not camera_text.startswith(SCHEME):
        raise InputError(
            "names no CARLA server",
            field="--camera",
            value=camera_text,
            remedy="give carla://HOST:PORT; `ssp run` draws by our own renderer",
        )
    address = parse_address(camera_text, "--camera")
    source = find_bag(recording)
    out = out or default_out(source)
    with BagReader(source) as bag:
        recorded = read_recorded(bag, read_provenance(bag))
        map_path, said_by = _map_of(recorded, map_file)
        sha256 = opendrive_sha256(read_map(map_path))
        with taken_folder(out.absolute().parent / f"{out.name}.drawing"):
            pictures = Pictures(out, recorded.facts.bag_sha256, sha256)
            if out.exists():
                _check_finished(out, recorded)
                pictures.remove()
                console.note(f"{out} is there already")
                return 0
            count = _draw(recorded, pictures, address, sha256)
            if pictures.server is None:
                raise InputError(
                    "has no frame at which a state of the VUT is known",
                    file=source,
                    remedy="give a recording with states of the VUT at its frames",
                )
            redrawing = Redrawing(
                of=recorded.name,
                of_sha256=recorded.facts.bag_sha256,
                map_file=map_path.name,
                map_sha256=sha256,
                map_said_by=said_by,
                frames=count,
                left_out=len(recorded.frames_ns) - count,
                software=f"ssp {__version__}",
            )
            write_redrawing(recorded, pictures, pictures.server, redrawing, out)
            pictures.remove()
    if as_json:
        click.echo(json.dumps(redrawing.model_dump(mode="json", by_alias=True)))
    else:
        console.out.print(f"{out}: {redrawing.frames} pictures, {redrawing.text}", markup=False)
    return 0


def default_out(bag: Path) -> Path:
    """Return the folder of a drawing that was given none, the same each time.

    Args:
        bag: of the recording.
    """
    place = bag_folder(bag).absolute()
    name = place.parent.name if place.name == "bag" else place.name
    return Path("out") / f"draw-{name}"


def _map_of(
    recorded: DrawableRecording, map_file: Path | None
) -> tuple[Path, Literal["the task", "--map"]]:
    """Return the map's file, and the authority that it is the recording's.

    Raises:
        InputError: there is none, or it can't be read, or another one was given than the run was
            compiled for.
    """
    task = attached(recorded.bag, TASK_FILE, Task)
    place = None if task is None else task.place
    is_compiled = place is not None and place.kind == "opendrive"
    if map_file is not None:
        read_map(map_file)
        if is_compiled and place is not None and sha256_file(map_file) != place.sha256:
            raise InputError(
                f"isn't the map that the run was compiled for, {place.name} ({place.sha256})",
                file=map_file,
                field="--map",
                remedy="leave it out, or give that one",
            )
        return map_file, "the task" if is_compiled else "--map"
    if place is None or not is_compiled:
        where = "nothing that it names" if place is None else f"a {place.kind}, {place.name}"
        raise InputError(
            f"was placed on {where}: no CARLA server has that map",
            file=recorded.bag.path,
            field="--map",
            remedy="give the OpenDRIVE of the server's map, in whose frame the states are",
        )
    file = bag_folder(recorded.bag.path).absolute().parent / TASK_FOLDER / place.name
    if not file.is_file():
        raise InputError(
            "isn't beside the bag",
            file=file,
            field="--map",
            remedy=f"give it: {place.name}, {place.sha256}",
        )
    if sha256_file(file) != place.sha256:
        raise InputError(
            f"isn't the map that the run was compiled for, {place.sha256}",
            file=file,
            remedy="give that one with --map",
        )
    return file, "the task"


def _check_finished(out: Path, recorded: DrawableRecording) -> None:
    """Raise InputError where the existing bag isn't this recording drawn anew."""
    with BagReader(out) as bag:
        there = attached(bag, DRAWN_ATTACHMENT, Redrawing)
    if there is None or there.of_sha256 != recorded.facts.bag_sha256:
        raise InputError("exists already", file=out, field="--out", remedy="name a new folder")


def _draw(
    recorded: DrawableRecording, pictures: Pictures, address: CarlaAddress, sha256: str
) -> int:
    """Draw what isn't drawn yet; gives the number of all pictures.

    Raises:
        PeerError: the server fails; what was drawn is kept.
    """
    painter: CarlaPainter | None = None
    count = 0

    def tell(record: Mapping[str, Any]) -> None:
        pictures.take_server(parse_model(CarlaScene, record, f"CARLA server {address}"))

    with console.progress("drawing", len(recorded.frames_ns)) as bar:
        try:
            for index, (stamp_ns, scene) in enumerate(scenes(recorded)):
                if not pictures.has(stamp_ns):
                    if painter is None:
                        shooting = recorded.shooting(scene)
                        painter = CarlaPainter(shooting, address, sha256, tell)
                    picture = painter.draw(scene, stamp_ns, index)
                    pictures.put(stamp_ns, jpeg(picture, recorded.camera.jpeg_quality))
                count += 1
                bar.advance(bar.task_ids[0])
        except PeerError as error:
            progress_text = (
                f"; {count} of {len(recorded.frames_ns)} are kept, and the same command goes on"
            )
            raise PeerError(f"{error}{progress_text if count else ''}") from error
        finally:
            if painter is not None:
                for line in painter.close():
                    console.report_error(line)
    return count
