"""What is imported, and what is said about it: the attachment ``import.json``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ssp_core.video import VideoInfo
from ssp_scenario_manager.spec.log import Record

SCHEMA = "ssp.import/1"
ATTACHMENT = "import.json"


@dataclass(frozen=True, slots=True)
class CameraFacts:
    """Geometry of the camera as far as somebody states it; nothing here is ever made up.

    Args:
        provenance: ``declared`` (known), ``assumed`` (a guess) or ``unknown``.
        hfov_deg: horizontal field of view.
        height_m: above ground.
        pitch_down_rad: + looks down.
    """

    provenance: Literal["declared", "assumed", "unknown"] = "unknown"
    hfov_deg: float | None = None
    height_m: float | None = None
    pitch_down_rad: float | None = None


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """One import.

    Args:
        video: source file.
        out: bag directory to make.
        start_s: crop, source time.
        end_s: crop, source time, exclusive; None: the end of the video.
        ego_speed_mps: constant speed of the camera's vehicle on a straight line, None: unknown.
        rate_hz: at least this many frames per second are kept, None: at least 10 where the video
            has them.
        max_width_px: wider frames are scaled down, None: never.
        camera: geometry.
        scenario: its name, None: not stated.
        event_version: K* version, None: not stated.
        generator: what made the video, free text.
        domain: of METHOD 5.2.
    """

    video: Path
    out: Path
    start_s: float
    end_s: float | None
    ego_speed_mps: float | None
    rate_hz: float | None = None
    max_width_px: int | None = None
    camera: CameraFacts = CameraFacts()
    scenario: str | None = None
    event_version: str | None = None
    generator: str = "unknown"
    domain: str = "synthetic"


DEFAULT_RATE_HZ = 10.0


def keep_every(fps: float, rate_hz: float | None) -> int:
    """n, where every n-th frame is kept: the largest that leaves at least the wanted rate.

    Whole frames at an even spacing and never under 10 Hz by default, so that a frame is always
    near enough to a label (METHOD 6.1 allows 0.11 s).

    Raises:
        ValueError: the video has fewer frames per second than were asked for.
    """
    if rate_hz is None:
        rate_hz = min(DEFAULT_RATE_HZ, fps)
    if rate_hz > fps * 1.001:
        raise ValueError(f"the video has {fps:g} frames per second, fewer than {rate_hz:g}")
    return max(1, math.floor(fps / rate_hz + 1e-3))


def output_size(info: VideoInfo, max_width_px: int | None) -> tuple[int, int]:
    """Width and height of the stored frames, px, aspect ratio kept."""
    if max_width_px is None or info.width_px <= max_width_px:
        return info.width_px, info.height_px
    return max_width_px, max(1, round(info.height_px * max_width_px / info.width_px))


def import_record(
    options: ImportOptions, info: VideoInfo, sha256: str, start_s: float, end_s: float
) -> dict[str, Any]:
    """The content of import.json.

    Args:
        options: what was asked for.
        info: what the container says.
        sha256: hash of the source file.
        start_s: source time of the first frame, which is t = 0 of the clip.
        end_s: source time at which the crop ends.
    """
    speed = options.ego_speed_mps
    return {
        "schema": SCHEMA,
        "source": {
            "name": options.video.name,
            "sha256": sha256,
            "width_px": info.width_px,
            "height_px": info.height_px,
            "fps": info.fps,
            "frames": info.frames,
        },
        "crop": {"start_s": start_s, "end_s": end_s},
        "generator": options.generator,
        "domain": options.domain,
        "scenario": options.scenario,
        "event_version": options.event_version,
        "ego": {
            "provenance": "unknown" if speed is None else "declared",
            "speed_mps": speed,
        },
        "camera": {
            "provenance": options.camera.provenance,
            "hfov_deg": options.camera.hfov_deg,
            "height_m": options.camera.height_m,
            "pitch_down_rad": options.camera.pitch_down_rad,
        },
    }


def source_log_entry(record: Mapping[str, Any], when: str) -> Record:
    """What log L keeps of the source: hash, generator, original and crop (METHOD 1).

    Args:
        record: the content of import.json.
        when: ISO 8601, UTC.
    """
    return Record(
        kind="source",
        when=when,
        who="ssp import-video",
        subject=record["scenario"] or record["source"]["name"],
        version=record["event_version"],
        reason="imported as a bag",
        details={
            "generator": record["generator"],
            "original": record["source"]["name"],
            "sha256": record["source"]["sha256"],
            "crop": record["crop"],
        },
    )
