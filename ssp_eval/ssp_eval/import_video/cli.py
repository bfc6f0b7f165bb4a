"""``ssp import-video``: make a bag from a video file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path

import click

from ssp_core.console import note, out, progress
from ssp_core.options import Domain, Number
from ssp_eval.import_video.importer import ImportSummary, import_clip
from ssp_eval.import_video.options import CameraFacts, ImportOptions, source_log_entry
from ssp_scenario_manager.spec.log_file import append_record, utc_now

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
VERSION = re.compile(r"sha256:[0-9a-f]{64}")


def _matching(
    pattern: re.Pattern[str], what: str
) -> Callable[[click.Context, click.Parameter, str | None], str | None]:
    def check(_: click.Context, __: click.Parameter, value: str | None) -> str | None:
        if value is not None and not pattern.fullmatch(value):
            raise click.BadParameter(f"{value!r} is no {what}")
        return value

    return check


@click.command("import-video")
@click.argument("video", type=click.Path(path_type=Path))
@click.option("--start", type=Number(0), default=0.0, help="Start of the crop, s [default: 0].")
@click.option("--end", type=Number(0), help="End of the crop, s [default: end of the video].")
@click.option("--ego-speed", type=Number(0, 100), help="Declared constant speed, m/s.")
@click.option("--ego-unknown", is_flag=True, help="The vehicle's speed is not known.")
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
@click.option("--camera-pitch-deg", type=Number(-45, 45), help="Downwards is positive.")
@click.option("--camera-assumed", is_flag=True, help="The camera's values are a guess.")
@click.option(
    "--scenario",
    callback=_matching(NAME, "name of letters, digits, _ . and -"),
    help="Name of the scenario.",
)
@click.option(
    "--event-version",
    callback=_matching(VERSION, "sha256:<64 hex digits>"),
    help="K* version that the video shows.",
)
@click.option("--generator", default="unknown", show_default=True, help="What made the video.")
@click.option("--domain", type=Domain(), default="synthetic", show_default=True)
@click.option("--max-width", type=click.IntRange(64, 8192), help="Scale wider frames down to PX.")
@click.option("--json", "json_", is_flag=True, help="Print JSON for programs.")
def import_video(
    video: Path,
    start: float,
    end: float | None,
    ego_speed: float | None,
    ego_unknown: bool,
    target: Path | None,
    rate: float | None,
    hfov_deg: float | None,
    camera_height: float | None,
    camera_pitch_deg: float | None,
    camera_assumed: bool,
    scenario: str | None,
    event_version: str | None,
    generator: str,
    domain: str,
    max_width: int | None,
    json_: bool,
) -> None:
    """Make a bag from a video file, or from a span of it.

    A video doesn't tell how fast its camera moved: state the speed with --ego-speed (recorded as
    declared), or say --ego-unknown. Times in the bag count from the first frame of the crop.
    Where the video comes from is entered into log L, <bag>.log.jsonl.
    """
    if (ego_speed is None) != ego_unknown:
        raise click.UsageError(
            "give exactly one of --ego-speed M_PER_S and --ego-unknown: a video doesn't tell how "
            "fast its camera moved, and it is never guessed"
        )
    if end is not None and start >= end:
        raise click.UsageError(f"--start {start:g} must lie before --end {end:g}")
    options = ImportOptions(
        video=video,
        out=target or Path(f"{video.stem}_bag"),
        start_s=start,
        end_s=end,
        ego_speed_mps=ego_speed,
        rate_hz=rate,
        max_width_px=max_width,
        camera=_camera(hfov_deg, camera_height, camera_pitch_deg, camera_assumed),
        scenario=scenario,
        event_version=event_version,
        generator=generator,
        domain=domain,
    )
    with progress("importing", None) as bar:
        task = bar.task_ids[0]
        summary = import_clip(options, lambda count: bar.advance(task, count))
    log = summary.bag.with_name(f"{summary.bag.name}.log.jsonl")
    append_record(log, source_log_entry(summary.record, utc_now()))
    if json_:
        click.echo(json.dumps(_as_json(summary), indent=1))
        return
    _report(summary)


def _camera(
    hfov_deg: float | None, height_m: float | None, pitch_deg: float | None, assumed: bool
) -> CameraFacts:
    if (height_m is None) != (pitch_deg is None):
        raise click.UsageError("--camera-height and --camera-pitch-deg belong together")
    if hfov_deg is None:
        if height_m is not None or assumed:
            raise click.UsageError("a camera's place is of no use without --hfov-deg")
        return CameraFacts()
    return CameraFacts(
        provenance="assumed" if assumed else "declared",
        hfov_deg=hfov_deg,
        height_m=height_m,
        pitch_down_rad=None if pitch_deg is None else math.radians(pitch_deg),
    )


def _as_json(summary: ImportSummary) -> dict[str, object]:
    return {
        "bag": str(summary.bag),
        "frames": summary.frames,
        "keep_every": summary.keep_every,
        "rate_hz": summary.rate_hz,
        "duration_s": summary.duration_s,
        "width_px": summary.width_px,
        "height_px": summary.height_px,
        "import": summary.record,
    }


def _report(summary: ImportSummary) -> None:
    if summary.keep_every > 1:
        note(f"kept one frame in {summary.keep_every}: {summary.rate_hz:g} Hz")
    out.print(
        f"{summary.bag}: {summary.frames} frames of {summary.width_px}x{summary.height_px} px, "
        f"{summary.duration_s:.3f} s",
        markup=False,
    )
