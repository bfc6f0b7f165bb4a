"""``ssp import-bag`` and ``ssp import-video``: third-party recordings made auditable."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from ssp_core.console import note, out, progress
from ssp_core.geodesy import Datum, Place
from ssp_core.names import VUT_ID
from ssp_core.options import Number, WholeNumber
from ssp_core.vocabulary import OBJECTS, ObjectClass
from ssp_core.world.camera import Mounting
from ssp_eval.importers.axes import Axes
from ssp_eval.importers.bag import BagOptions, import_bag
from ssp_eval.importers.clocks import Clock
from ssp_eval.importers.options import (
    ALL,
    MotionOptions,
    accept_option,
    declaring,
    domain_option,
    import_options,
    moving,
    numbers,
    pairs,
)
from ssp_eval.importers.target import CameraFacts, ImportSummary, log_source, pinhole
from ssp_eval.importers.video import TableOptions, VideoOptions, import_clip


@click.command("import-video")
@click.argument("video", type=click.Path(path_type=Path))
@click.option("--start", type=Number(0), default=0.0, help="Start of the crop, s [default: 0].")
@click.option("--end", type=Number(0), help="End of the crop, s [default: end of the video].")
@click.option("--ego-speed", type=Number(0, 100), help="Declared constant speed, m/s.")
@click.option("--ego-unknown", is_flag=True, help="The vehicle's speed is not known.")
@click.option(
    "--states",
    type=click.Path(path_type=Path),
    help="CSV with the states of VUT and objects (docs/importing.md).",
)
@click.option("--vut", default=VUT_ID, show_default=True, help="Id of the VUT in the table.")
@click.option(
    "--object",
    "objects",
    multiple=True,
    metavar="ID=TABLE_ID",
    help="Object target by its id in the table [default: all, by their own ids].",
)
@click.option("--time-offset", type=Number(), default=0.0, help="Added to the table's times, s.")
@moving
@click.option(
    "--out",
    "target",
    type=click.Path(path_type=Path),
    help="Bag directory to make [default: VIDEO's name + _bag].",
)
@click.option(
    "--rate",
    type=Number(0, 1000, low_open=True),
    help="Keep every n-th frame, with the largest n that leaves at least HZ frames per second "
    "[default: 10, or all of a slower video].",
)
@click.option("--hfov-deg", type=Number(10, 150), help="Horizontal field of view.")
@click.option("--camera-height", type=Number(0, 10, low_open=True), help="Above ground, m.")
@click.option("--camera-forward", type=Number(-10, 10), help="Ahead of the rear axle, m.")
@click.option("--camera-pitch-deg", type=Number(-45, 45), help="Downwards is positive.")
@click.option("--camera-assumed", is_flag=True, help="The camera's values are a guess.")
@domain_option("synthetic")
@declaring
@accept_option()
@click.option(
    "--accept-damaged",
    "most_damaged",
    type=WholeNumber(0),
    default=0,
    show_default=True,
    metavar="N",
    help="Number of decoder errors to accept; the bag says how many there were.",
)
@click.option("--json", "json_", is_flag=True, help="Print JSON for programs.")
def import_video(
    video: Path,
    target: Path | None,
    states: Path | None,
    vut: str,
    objects: tuple[str, ...],
    time_offset: float,
    ego_speed: float | None,
    ego_unknown: bool,
    most_damaged: int,
    json_: bool,
    **given: Any,
) -> None:
    """Make a bag from a video file, or from a span of it.

    A video doesn't show how fast its camera moved: give the states of its simulator or positioning
    system with --states, state the speed with --ego-speed (recorded as declared), or say
    --ego-unknown. Times in the bag count from the first frame of the crop. The video's origin is
    entered into log L, <bag>.log.jsonl.
    """
    if (ego_speed is not None) + ego_unknown + (states is not None) != 1:
        raise click.UsageError(
            "give exactly one of --states FILE.csv, --ego-speed M_PER_S and --ego-unknown: a video "
            "doesn't tell how fast its camera moved, and it is never guessed"
        )
    options = import_options(target or Path(f"{video.stem}_bag"), given)
    table = None
    if states is not None:
        table = TableOptions(states, vut, pairs("--object", objects), time_offset)
    elif objects or time_offset or options.motion != MotionOptions() or vut != VUT_ID:
        raise click.UsageError("options about objects and road are of no use without --states")
    camera = _camera(given)
    with progress("importing", None) as bar:
        task = bar.task_ids[0]
        summary = import_clip(
            VideoOptions(video, options, camera, ego_speed, table, most_damaged),
            lambda count: bar.advance(task, count),
        )
    finish(summary, "ssp import-video", options.accepted, json_)


def _camera(arguments: Mapping[str, Any]) -> Callable[[int, int], CameraFacts]:
    """Return the camera as a person describes it, by the size of its frames, px."""
    hfov_deg, assumed = arguments["hfov_deg"], arguments["camera_assumed"]
    height_m, pitch_deg = arguments["camera_height"], arguments["camera_pitch_deg"]
    forward_m = arguments["camera_forward"]
    if (height_m is None) != (pitch_deg is None):
        raise click.UsageError("--camera-height and --camera-pitch-deg belong together")
    if forward_m is not None and height_m is None:
        raise click.UsageError("--camera-forward needs --camera-height and --camera-pitch-deg")
    if hfov_deg is None and (height_m is not None or assumed):
        raise click.UsageError("a camera's place is of no use without --hfov-deg")
    if hfov_deg is None:
        return lambda _width_px, _height_px: CameraFacts()
    mounting = None
    if height_m is not None:
        mounting = Mounting(forward_m or 0.0, height_m, math.radians(pitch_deg))
    return lambda width_px, height_px: CameraFacts(
        "assumed" if assumed else "declared", pinhole(width_px, height_px, hfov_deg), mounting
    )


def finish(summary: ImportSummary, who: str, accepted: Sequence[str], json_: bool) -> None:
    """Enter the source into log L and report: the end of both importers."""
    log_source(summary, who)
    if json_:
        click.echo(json.dumps(summary.as_json(), indent=1))
        return
    if summary.keep_every > 1:
        note(f"kept one frame in {summary.keep_every}: {summary.rate_hz:g} Hz")
    if damaged := summary.record.source.get("decoder_errors"):
        note(f"the decoder reported {damaged} errors: pictures may be damaged")
    for one in summary.record.accepted:
        note(f"accepted as it is, {one.name}: {one.text}")
    for name in sorted(set(accepted) - set(summary.record.accepted_names)):
        note(f"--accept {name}: nothing of that name was found")
    for line in summary.record.notes:
        note(line)
    states = summary.record.states
    for line in [] if states is None else states.notes:
        note(line)
    out.print(summary.text, markup=False)


@click.command("import-bag")
@click.argument("bag", type=click.Path(path_type=Path))
@click.option("--vut", required=True, metavar="TOPIC[:CLASS]", help="Poses of the VUT.")
@click.option(
    "--object",
    "objects",
    multiple=True,
    required=True,
    metavar="ID=TOPIC:CLASS",
    help="Poses of an object target, such as ot1=/target/odom:car.",
)
@click.option("--camera", required=True, help="Topic of the forward camera.")
@click.option("--camera-info", help="Topic of its CameraInfo.")
@click.option(
    "--mount",
    metavar="X,Y,Z,PITCH_DEG[,YAW_DEG[,ROLL_DEG]]",
    help="Camera ahead of, left of and above the VUT's reference point, m; degrees, looking down, "
    "left and leaning right are positive [default: /tf_static].",
)
@click.option("--start", type=Number(0), default=0.0, help="Start, s after the first frame.")
@click.option("--end", type=Number(0), help="End, s after the first frame [default: all].")
@click.option(
    "--clock",
    type=click.Choice(["header", "receive"]),
    default="header",
    show_default=True,
    help="Times of the headers, or of receipt.",
)
@click.option(
    "--datum",
    metavar="LAT,LON[,ALT]",
    help="Origin of the map's frame, for geodetic positions (NavSatFix): degrees, m.",
)
@click.option(
    "--size",
    "sizes",
    multiple=True,
    metavar="ID=LxWxH",
    help="Length, width and height, m [default: typical of the class].",
)
@click.option(
    "--axes",
    "axes",
    multiple=True,
    metavar="ID=WORLD[/BODY]",
    help="Axes of an object's poses: enu (east, north, up: REP 103), ned (north, east, down), frd "
    "(forward, right, down); of its child frame: flu or frd [default: enu/flu, ned/frd, frd/frd].",
)
@click.option(
    "--twist",
    "twists",
    multiple=True,
    metavar="ID=child|parent",
    help="An object's twist is along the axes of its child frame, or of its poses' frame.",
)
@moving
@click.option(
    "--out",
    "target",
    type=click.Path(path_type=Path),
    help="Bag directory to make [default: BAG's name + _imported].",
)
@click.option(
    "--rate",
    type=Number(0, 1000, low_open=True),
    help="Keep every n-th frame, with the largest n that leaves at least HZ frames per second "
    "[default: 10, or all of a slower camera].",
)
@domain_option(None)
@declaring
@accept_option()
@click.option("--json", "json_", is_flag=True, help="Print JSON for programs.")
def import_bag_command(
    bag: Path,
    target: Path | None,
    vut: str,
    objects: tuple[str, ...],
    camera: str,
    camera_info: str | None,
    mount: str | None,
    clock: Clock,
    datum: str | None,
    axes: tuple[str, ...],
    twists: tuple[str, ...],
    json_: bool,
    **given: Any,
) -> None:
    """Turn somebody else's ROS 2 bag (MCAP or SQLite) into a recording that can be audited.

    The poses of VUT and objects come as nav_msgs/Odometry (also PoseStamped,
    PoseWithCovarianceStamped, NavSatFix), the frames as CompressedImage or Image. Clocks, frames,
    gaps and speeds are checked; derived and assumed values are reported and kept in the recording.
    Its origin is entered into log L, <out>.log.jsonl.
    """
    topics = {VUT_ID: _topic("--vut", vut, "car")}
    for name, text in pairs("--object", objects).items():
        if name == VUT_ID:
            raise click.UsageError(f"--object {name}=…: that is the VUT's id")
        topics[name] = _topic(f"--object {name}", text, None)
    options = BagOptions(
        bag=bag,
        clip=import_options(target or Path(f"{bag.stem}_imported"), given),
        objects=topics,
        camera=camera,
        camera_info=camera_info,
        mounting=None if mount is None else _mounting(mount),
        clock=clock,
        datum=None if datum is None else _datum(datum),
        axes=_axes(axes, topics),
        twist_in_parent=_twists(twists, topics),
    )
    with progress("importing", None) as bar:
        task = bar.task_ids[0]
        summary = import_bag(
            options,
            lambda total: bar.update(task, total=total),
            lambda count: bar.advance(task, count),
        )
    finish(summary, "ssp import-bag", options.clip.accepted, json_)


def _topic(option: str, text: str, default: str | None) -> tuple[str, ObjectClass]:
    """Return TOPIC:CLASS; raises UsageError for another form."""
    topic, sign, word = text.rpartition(":")
    if not sign:
        topic, word = text, default or ""
    if word not in OBJECTS or not topic:
        raise click.UsageError(
            f"{option} {text}: give TOPIC:CLASS; classes are {', '.join(OBJECTS)}"
        )
    return topic, ObjectClass.from_word(word)


def _axes(arguments: tuple[str, ...], ids: Collection[str]) -> dict[str, Axes]:
    """Return axes by id; raises UsageError for another form, or an id that is none."""
    axes_by_id = {}
    for name, text in _by_id("--axes", arguments, ids).items():
        try:
            axes_by_id[name] = Axes.of_text(text)
        except ValueError as error:
            raise click.UsageError(f"--axes {name}={text}: {error}") from error
    return axes_by_id


def _twists(arguments: tuple[str, ...], ids: Collection[str]) -> dict[str, bool]:
    """Read by id whether twists are in the poses' frame; raises UsageError as ``_axes``."""
    twist_in_parent = {}
    for name, text in _by_id("--twist", arguments, ids).items():
        if text not in ("child", "parent"):
            raise click.UsageError(f"--twist {name}={text}: give child or parent")
        twist_in_parent[name] = text == "parent"
    return twist_in_parent


def _by_id(option: str, arguments: tuple[str, ...], ids: Collection[str]) -> dict[str, str]:
    """Return ID=VALUE options by id, `all` for those that aren't named."""
    stated = pairs(option, arguments)
    common = stated.pop(ALL, None)
    for name in stated:
        if name not in ids:
            raise click.UsageError(f"{option} {name}=…: the ids are {', '.join(ids)}")
    return ({} if common is None else dict.fromkeys(ids, common)) | stated


def _mounting(text: str) -> Mounting:
    x_m, y_m, z_m, *angles = numbers("--mount", text, "X,Y,Z,PITCH_DEG,YAW_DEG,ROLL_DEG", least=4)
    pitch, yaw, roll = (math.radians(a) for a in [*angles, 0.0, 0.0][:3])
    if not 0.0 < z_m <= 10.0 or abs(pitch) > math.radians(45.0):
        raise click.UsageError(f"--mount {text}: Z in (0, 10] m, PITCH_DEG within -45 and 45")
    return Mounting(x_m, z_m, pitch, y_m, yaw, roll)


def _datum(text: str) -> Datum:
    latitude, longitude, *altitude = numbers("--datum", text, "LAT,LON,ALT", least=2)
    place = Place(latitude, longitude, *altitude)
    if place.problem is not None:
        raise click.UsageError(f"--datum {text}: {place.problem}, as LAT,LON[,ALT]")
    return Datum(place)
