"""``ssp import-video``: make a bag from a video file."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import click

from ssp_core.cli import Number
from ssp_core.console import note, out, progress
from ssp_core.names import VUT_ID
from ssp_core.world.camera import Mounting
from ssp_eval.imports.declare import declared, declaring
from ssp_eval.imports.motion_options import motion_options, moving, pairs
from ssp_eval.imports.target import ImportSummary, log_source
from ssp_eval.imports.video import LensOptions, TableOptions, VideoOptions, import_clip


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
    help="Keep every n-th frame, n as large as leaves at least HZ frames per second "
    "[default: 10, or all of a slower video].",
)
@click.option("--hfov-deg", type=Number(10, 150), help="Horizontal field of view.")
@click.option("--camera-height", type=Number(0, 10, low_open=True), help="Above ground, m.")
@click.option("--camera-forward", type=Number(-10, 10), help="Ahead of the rear axle, m.")
@click.option("--camera-pitch-deg", type=Number(-45, 45), help="Downwards is positive.")
@click.option("--camera-assumed", is_flag=True, help="The camera's values are a guess.")
@declaring("synthetic")
@click.option("--max-width", type=click.IntRange(64, 8192), help="Scale wider frames down to PX.")
@click.option(
    "--accept-damaged",
    "most_damaged",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    metavar="N",
    help="Errors of the decoder that are accepted; the bag says how many there were.",
)
@click.option("--json", "json_", is_flag=True, help="Print JSON for programs.")
def import_video(
    video: Path,
    start: float,
    end: float | None,
    ego_speed: float | None,
    ego_unknown: bool,
    states: Path | None,
    vut: str,
    objects: tuple[str, ...],
    time_offset: float,
    site: str | None,
    block: str | None,
    transforms: tuple[str, ...],
    references: tuple[str, ...],
    headings: tuple[str, ...],
    target: Path | None,
    rate: float | None,
    hfov_deg: float | None,
    camera_height: float | None,
    camera_forward: float | None,
    camera_pitch_deg: float | None,
    camera_assumed: bool,
    max_width: int | None,
    most_damaged: int,
    json_: bool,
    **said: Any,
) -> None:
    """Make a bag from a video file, or from a span of it.

    A video doesn't tell how fast its camera moved: give the states of its simulator or positioning
    system with --states, state the speed with --ego-speed (recorded as declared), or say
    --ego-unknown. Times in the bag count from the first frame of the crop. Where the video comes
    from is entered into log L, <bag>.log.jsonl.
    """
    if (ego_speed is not None) + ego_unknown + (states is not None) != 1:
        raise click.UsageError(
            "give exactly one of --states FILE.csv, --ego-speed M_PER_S and --ego-unknown: a video "
            "doesn't tell how fast its camera moved, and it is never guessed"
        )
    if end is not None and start >= end:
        raise click.UsageError(f"--start {start:g} must lie before --end {end:g}")
    motion = motion_options(site, block, transforms, references, headings)
    table = None
    if states is not None:
        table = TableOptions(states, vut, pairs("--object", objects), time_offset, motion)
    elif objects or time_offset or site or transforms or references or headings or vut != VUT_ID:
        raise click.UsageError("options about objects and road are of no use without --states")
    options = VideoOptions(
        video=video,
        out=target or Path(f"{video.stem}_bag"),
        start_s=start,
        end_s=end,
        ego_speed_mps=ego_speed,
        rate_hz=rate,
        max_width_px=max_width,
        lens=_lens(hfov_deg, camera_height, camera_forward, camera_pitch_deg, camera_assumed),
        declared=declared(**said),
        table=table,
        most_damaged=most_damaged,
    )
    with progress("importing", None) as bar:
        task = bar.task_ids[0]
        summary = import_clip(options, lambda count: bar.advance(task, count))
    finish(summary, "ssp import-video", json_)


def _lens(
    hfov_deg: float | None,
    height_m: float | None,
    forward_m: float | None,
    pitch_deg: float | None,
    assumed: bool,
) -> LensOptions:
    if (height_m is None) != (pitch_deg is None):
        raise click.UsageError("--camera-height and --camera-pitch-deg belong together")
    if forward_m is not None and height_m is None:
        raise click.UsageError("--camera-forward needs --camera-height and --camera-pitch-deg")
    if hfov_deg is None and (height_m is not None or assumed):
        raise click.UsageError("a camera's place is of no use without --hfov-deg")
    mounting = None
    if height_m is not None and pitch_deg is not None:
        mounting = Mounting(forward_m or 0.0, height_m, math.radians(pitch_deg))
    return LensOptions(hfov_deg, mounting, assumed)


def finish(summary: ImportSummary, who: str, json_: bool) -> None:
    """Enters the source into log L and reports: the end of both importers."""
    log_source(summary, who)
    if json_:
        click.echo(json.dumps(summary.as_json(), indent=1))
        return
    if summary.keep_every > 1:
        note(f"kept one frame in {summary.keep_every}: {summary.rate_hz:g} Hz")
    if damaged := summary.record.source.get("decoder_errors"):
        note(f"the decoder reported {damaged} errors: pictures may be damaged")
    states = summary.record.states
    for line in [] if states is None else states.notes:
        note(line)
    out.print(summary.text, markup=False)
