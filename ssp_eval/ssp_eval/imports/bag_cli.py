"""``ssp import-bag``: make a recording that can be audited of anybody's ROS 2 bag."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from ssp_core.cli import Number
from ssp_core.console import progress
from ssp_core.names import VUT_ID
from ssp_core.vocabulary import OBJECTS, ObjectClass
from ssp_core.world.camera import Mounting
from ssp_eval.imports.bag import BagOptions, import_bag
from ssp_eval.imports.clocks import Clock
from ssp_eval.imports.declare import declared, declaring
from ssp_eval.imports.geodesy import Datum
from ssp_eval.imports.motion_options import motion_options, moving, numbers, pairs
from ssp_eval.imports.video_cli import finish


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
    help="Keep every n-th frame, n as large as leaves at least HZ frames per second [default: 10, "
    "or all of a slower camera].",
)
@click.option("--max-width", type=click.IntRange(64, 8192), help="Scale wider frames down to PX.")
@declaring(None)
@click.option("--json", "json_", is_flag=True, help="Print JSON for programs.")
def import_bag_command(
    bag: Path,
    vut: str,
    objects: tuple[str, ...],
    camera: str,
    camera_info: str | None,
    mount: str | None,
    start: float,
    end: float | None,
    clock: Clock,
    datum: str | None,
    sizes: tuple[str, ...],
    site: str | None,
    block: str | None,
    transforms: tuple[str, ...],
    references: tuple[str, ...],
    headings: tuple[str, ...],
    target: Path | None,
    rate: float | None,
    max_width: int | None,
    json_: bool,
    **said: Any,
) -> None:
    """Make a recording that can be audited of a ROS 2 bag (MCAP or SQLite) that others recorded.

    The poses of VUT and objects come as nav_msgs/Odometry (also PoseStamped,
    PoseWithCovarianceStamped, NavSatFix), the frames as CompressedImage or Image. Clocks, frames,
    gaps and speeds are checked; what is derived or taken for granted is said and kept in the
    recording. Where it comes from is entered into log L, <out>.log.jsonl.
    """
    if end is not None and start >= end:
        raise click.UsageError(f"--start {start:g} must lie before --end {end:g}")
    named = {VUT_ID: _topic("--vut", vut, "car")}
    for name, text in pairs("--object", objects).items():
        if name == VUT_ID:
            raise click.UsageError(f"--object {name}=…: that is the VUT's id")
        named[name] = _topic(f"--object {name}", text, None)
    options = BagOptions(
        bag=bag,
        out=target or Path(f"{bag.stem}_imported"),
        objects=named,
        camera=camera,
        camera_info=camera_info,
        mounting=None if mount is None else _mounting(mount),
        start_s=start,
        end_s=end,
        rate_hz=rate,
        max_width_px=max_width,
        clock=clock,
        datum=None if datum is None else _datum(datum),
        motion=motion_options(site, block, transforms, references, headings, sizes),
        declared=declared(**said),
    )
    with progress("importing", None) as bar:
        task = bar.task_ids[0]
        summary = import_bag(
            options,
            lambda total: bar.update(task, total=total),
            lambda count: bar.advance(task, count),
        )
    finish(summary, "ssp import-bag", json_)


def _topic(option: str, text: str, default: str | None) -> tuple[str, ObjectClass]:
    """TOPIC:CLASS; raises UsageError for another form."""
    topic, sign, word = text.rpartition(":")
    if not sign:
        topic, word = text, default or ""
    if word not in OBJECTS or not topic:
        raise click.UsageError(
            f"{option} {text}: give TOPIC:CLASS; classes are {', '.join(OBJECTS)}"
        )
    return topic, ObjectClass.from_word(word)


def _mounting(text: str) -> Mounting:
    x_m, y_m, z_m, *angles = numbers("--mount", text, "X,Y,Z,PITCH_DEG,YAW_DEG,ROLL_DEG", least=4)
    pitch, yaw, roll = (math.radians(a) for a in [*angles, 0.0, 0.0][:3])
    if not 0.0 < z_m <= 10.0 or abs(pitch) > math.radians(45.0):
        raise click.UsageError(f"--mount {text}: Z in (0, 10] m, PITCH_DEG within -45 and 45")
    return Mounting(x_m, z_m, pitch, y_m, yaw, roll)


def _datum(text: str) -> Datum:
    latitude, longitude, *altitude = numbers("--datum", text, "LAT,LON,ALT", least=2)
    if abs(latitude) > 90.0 or abs(longitude) > 180.0:
        raise click.UsageError(f"--datum {text}: LAT within -90 and 90, LON within -180 and 180")
    return Datum(latitude, longitude, *altitude)
