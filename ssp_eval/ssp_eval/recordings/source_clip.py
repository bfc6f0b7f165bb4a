"""``ssp spec clip``: a synthetic source clip, and the K* that is bound to it by hash (METHOD 4.3).

The event is drawn on the road that its part T names, or on another number of lanes. What the clip
shows goes into the new K*: its hash, the road, and the phases as METHOD 1 finds them in the ground
truth. That is a version of its own; the event that it was made from qualifies no video.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files.folders import new_files
from ssp_core.geometry import Polyline, box_distance
from ssp_core.hashing import sha256_file
from ssp_core.motion.event import find_event, instants_of
from ssp_core.motion.intrusion import first_intrusions
from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.motion.state_series import Series
from ssp_core.options import WholeNumber
from ssp_core.vocabulary import PHASES, ObjectClass, PhaseWord
from ssp_eval.recordings.event import rules_of
from ssp_ot_controller.camera import clip
from ssp_ot_controller.camera.further_actors import FurtherActor, with_further
from ssp_ot_controller.camera.storyboards import (
    CAR,
    LaneCounts,
    Storyboard,
    usual_lanes,
)
from ssp_scenario_manager.checks.check import check_event
from ssp_scenario_manager.compile.compiler import EventRefused, checked_event
from ssp_scenario_manager.event_spec.load import event_version, seal_event, seals, write_event
from ssp_scenario_manager.event_spec.log import Record, append_records, log_path, utc_now
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.event_spec.other_lanes import topology_with_lanes
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from ssp_scenario_manager.scenarios.further import CLEAR_M, facing_rad, further_ids, stands
from ssp_scenario_manager.scenarios.values import quantity_at

WHO = "ssp spec clip"
# What a storyboard draws, whatever the event says.
_DRAWN = {
    "cut_in": ("cutting_in_from_left", "car"),
    "lead_braking": ("same_direction", "car"),
    "vru_crossing": ("crossing_from_right", "pedestrian"),
    "occluded_crossing": ("crossing_from_right", "pedestrian"),
    "slow_lead": ("same_direction", "car"),
    "crossing_car": ("crossing_from_right", "car"),
    "oncoming_turn": ("oncoming", "car"),
    "merge": ("cutting_in_from_right", "car"),
    "cut_out": ("stationary", "car"),
    "vut_turn": ("crossing_from_right", "car"),
    "roundabout": ("crossing_from_left", "car"),
}


@dataclass(frozen=True)
class ClipPhases:
    """The starts of the phases in a clip, s and frames from its first frame."""

    starts_s: Mapping[PhaseWord, float]
    first_frames: Mapping[PhaseWord, int]
    last_frame: int
    fps: float


def board_of(event: Event, seed: int, lanes: tuple[int, int] | None = None) -> Storyboard:
    """Return the storyboard of an event's clip, before it is drawn.

    Args:
        event: whose kind, and whose road unless ``lanes`` says otherwise, is drawn.
        seed: of speeds, timing and light.
        lanes: of the road; None: as part T says, two each way where it doesn't.

    Raises:
        InputError: the storyboards don't draw such an event.
    """
    interaction, road = event.interaction, event.topology
    kind = KINDS.get(interaction.type)
    motion, class_ = _DRAWN.get(interaction.type, ("", ""))
    initiator = event.participants[interaction.initiator]
    comparisons = {
        "interaction.dominant_motion": (interaction.dominant_motion, motion),
        f"participants.{interaction.initiator}.class": (initiator.class_, class_),
        "topology.segment": (
            road.segment.value,
            "junction" if kind is not None and kind.at_junction else "straight",
        ),
        "topology.vut_lane": (road.vut_lane.value, "rightmost"),
    }
    for field, (value, generator_value) in comparisons.items():
        if value != generator_value:
            raise InputError(
                "can't be drawn by the project's clip generator",
                file=event.name,
                field=field,
                value=value,
                remedy=f"it draws {generator_value or 'no such event'}; name a source clip of your "
                "own in source.sha256 for any other",
            )
    lane_counts = [road.lanes_same_direction.value, road.lanes_opposite.value]
    same, opposite = (count if isinstance(count, int) else 2 for count in lane_counts)
    board = clip.board_of(interaction.type, seed, *(lanes or (same, opposite)))
    return with_further(board, [_further(event, name) for name in further_ids(event)])


def _further(event: Event, name: str) -> FurtherActor:
    """Return a further participant as the clip shows it: in the middle of part C's values.

    Raises:
        InputError: its gap or its speed has no middle.
    """
    who, values = event.participants[name], dict[str, float]()
    speed = f"constraints.speeds.{name}.approach"
    fields = [f"participants.{name}.region.gap", *(() if stands(event, name) else (speed,))]
    for field in fields:
        quantity = quantity_at(event, field)
        middle = quantity.si.mid if isinstance(quantity, Interval) else math.inf
        if math.isinf(middle):
            raise InputError(
                "can't be drawn", file=event.name, field=field, remedy="a closed interval"
            )
        values[field] = middle
    gap_m, object_class = values[fields[0]], ObjectClass.from_word(who.class_)
    behind_m = -CAR.length_m - gap_m - DEFAULT_SIZES[object_class].length_m
    return FurtherActor(
        object_id=name,
        object_class=object_class,
        place=who.region.place,
        ahead_m={"ahead": gap_m, "behind": behind_m}.get(who.region.along, -CAR.length_m),
        speed_mps=values.get(speed, 0.0),
        facing_rad=facing_rad(event, name),
    )


def measure_clip(event: Event, board: Storyboard) -> ClipPhases:
    """Find the phases of a clip in its ground truth with the event's thresholds (METHOD 1).

    Raises:
        InputError: the clip doesn't show the event.
    """
    times = board.times()
    series = [(t_s, {s.object_id: s for s in board.states(t_s)}) for t_s in times]
    samples = instants_of(series, event.vut_id, event.interaction.initiator)
    thresholds = rules_of(event).thresholds
    road = Polyline(board.vut_path)
    kind = KINDS[event.interaction.type]
    detection = (
        find_event(samples, road, thresholds, observable=kind.observable) if samples else None
    )
    if detection is None or detection.conflict_s is None or detection.resolution_s is None:
        raise InputError(
            "has no conflict that begins and ends in the clip, by its own ids and thresholds",
            file=event.name,
            field="constraints.thresholds",
            value=f"ttc {thresholds.ttc_s} s, arrival gap {thresholds.arrival_gap_s} s",
            remedy="other thresholds, another --seed, or the ids vut, ot1 and ot2",
        )
    others = [instants_of(series, event.vut_id, name) for name in further_ids(event)]
    for intrusion in first_intrusions(others, road, thresholds, detection.resolution_s):
        raise InputError(
            f"would show another conflict: {intrusion.text(thresholds)}",
            file=event.name,
            field=f"participants.{intrusion.object_id}.region.gap",
            remedy="a larger gap, or speeds that differ less",
        )
    _keep_clear(event, series)
    starts_s = dict(
        zip(
            PHASES,
            (times[0], detection.trigger_s, detection.conflict_s, detection.resolution_s),
            strict=True,
        )
    )
    frames = {phase: round(t_s * board.fps) for phase, t_s in starts_s.items()}
    return ClipPhases(starts_s, frames, len(times) - 1, board.fps)


def _keep_clear(event: Event, series: Series) -> None:
    """Check that further participants keep clear of all others in every frame.

    Raises:
        InputError: one comes nearer to another object than the compiler lets them start.
    """
    for name in further_ids(event):
        for t_s, states in series:
            for other, state in states.items():
                apart_m = box_distance(states[name].box, state.box)
                if other != name and apart_m < CLEAR_M:
                    raise InputError(
                        f"would show {name} {apart_m:.2f} m from {other} at {t_s:.2f} s, "
                        f"{CLEAR_M:g} m keep them clear of each other",
                        file=event.name,
                        field=f"participants.{name}.region.gap",
                        remedy="another gap, place or speed, or another --seed",
                    )


def bind_event(event: Event, board: Storyboard, phases: ClipPhases, sha256: str) -> Event:
    """Return the event as this clip shows it: source, parts T and E, and the seals that held."""
    sealed_paths = {
        path for path, seal in seals(event).items() if event.uncertainty[path].seal == seal
    }
    counts = sum(lane.direction == "forward" for lane in board.road.lanes)
    original = f"{board.scenario} seed {board.seed}"
    opposite = len(board.road.lanes) - counts
    if LaneCounts(counts, opposite) != usual_lanes(board.scenario):
        original += f", lanes {counts}+{opposite}"
    value = event.model_dump(mode="json", by_alias=True)
    value["source"] = {
        "generator": clip.GENERATOR,
        "original": original,
        "sha256": sha256,
        "rate": _at(board.fps, "Hz"),
    }
    value["topology"] = topology_with_lanes(event.topology, counts, opposite)
    value["events"] = _events(board, phases)
    value["uncertainty"] = {
        path: entry | {"source": _source(entry["source"], event, original, phases)}
        for path, entry in value["uncertainty"].items()
    }
    return seal_event(Event.model_validate(value), sorted(sealed_paths))


def _events(board: Storyboard, phases: ClipPhases) -> dict[str, Any]:
    """Return part E: exact starts, and evidence from each phase's first frame to the next."""
    ends = [*(phases.first_frames[phase] for phase in PHASES), phases.last_frame]
    part: dict[str, Any] = {"clip": {"start": _at(0.0, "s"), "end": _at(board.duration_s, "s")}}
    for phase, (first, last) in zip(PHASES, pairwise(ends), strict=True):
        span_s = [round(frame / phases.fps, 3) for frame in (first, last)]
        part[phase] = {
            "start": _at(round(phases.starts_s[phase], 3), "s"),
            "evidence": [{"frames": [first, last], "span_s": span_s}],
        }
    return part


def _source(text: str, event: Event, original: str, phases: ClipPhases) -> str:
    """Convert frames of the clip before into frames of this one."""
    old = f"{event.source.generator} {event.source.original}"
    before, separator, after = text.partition(old)
    if not separator:
        return text
    frames = {}
    for phase in PHASES:
        evidence = getattr(event.events, phase).evidence[0].frames
        if evidence is not None:
            frames[evidence[0]] = phases.first_frames[phase]
            if phase == "resolution":
                frames[evidence[1]] = phases.last_frame

    def of_this_clip(numbers: re.Match[str]) -> str:
        return re.sub(r"\d+", lambda n: str(frames.get(int(n[0]), n[0])), numbers[0])

    return re.sub(r"frames? [\d, -]+", of_this_clip, before) + f"{clip.GENERATOR} {original}{after}"


def _at(value: float, unit: str) -> dict[str, Any]:
    return {"min": value, "max": value, "unit": unit}


def _lanes(_: click.Context, __: click.Parameter, text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    match = re.fullmatch(r"(\d)\+(\d)", text)
    if match is None:
        raise click.BadParameter(f"{text}: type lanes with and against the VUT, such as 1+1")
    return int(match[1]), int(match[2])


@click.command("clip")
@click.argument("event")
@click.option(
    "--seed",
    default=1,
    show_default=True,
    type=WholeNumber(0, 2**31),
    help="Seed of speeds, timing and light.",
)
@click.option(
    "--lanes",
    callback=_lanes,
    metavar="N+M",
    help="Lanes in the VUT's direction, and oncoming ones [default: those of the event's part T].",
)
@click.option(
    "--out",
    default="out/clips",
    show_default=True,
    metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder to write to.",
)
@click.option("--force", is_flag=True, help="Replace an existing clip and its K*.")
def clip_command(
    event: str, seed: int, lanes: tuple[int, int] | None, out: Path, force: bool
) -> int:
    """Make a synthetic clip of EVENT and the K* bound to it.

    EVENT is a K* file or the name of a shipped one. It writes NAME.mp4, NAME.truth.json (ground
    truth, for labels), NAME.event.yaml (the K*: use this one from here on) and NAME.log.jsonl.
    """
    k_star, version, path = checked_event(event)
    board = board_of(k_star, seed, lanes)
    phases = measure_clip(k_star, board)
    video = out / f"{k_star.name}.mp4"
    bound_path = out / f"{k_star.name}.event.yaml"
    for file in (video, bound_path):
        if file.exists() and not force:
            raise InputError("exists already", file=file, remedy="another --out, or --force")
    failures = check_event(bind_event(k_star, board, phases, f"sha256:{'0' * 64}"))
    if failures:
        raise EventRefused(path, failures)
    with (
        new_files(out) as scratch,
        console.progress(f"drawing {video.name}", len(board.times())) as bar,
    ):
        task = bar.task_ids[0]
        clip.write_clip(board, scratch / video.name, lambda: bar.advance(task))
        bound = bind_event(k_star, board, phases, sha256_file(scratch / video.name))
        write_event(scratch / bound_path.name, bound)
    append_records(log_path(bound_path), [_record(bound, board, version)])
    click.echo(console.visible(f"{video}\n{clip.truth_path(video)}\n{bound_path}"))
    click.echo(f"K* {event_version(bound)}")
    return 0


def _record(bound: Event, board: Storyboard, version: str) -> Record:
    """Return the entry of L about the source: hash, generator, original and crop (METHOD 1)."""
    return Record(
        kind="source",
        when=utc_now(),
        who=WHO,
        subject=bound.name,
        reason="synthetic source clip, made for the event and bound to it",
        details={
            "sha256": bound.source.sha256,
            "generator": bound.source.generator,
            "original": bound.source.original,
            "crop": {"start_s": 0.0, "end_s": board.duration_s, "first_frame": 0},
            "rate_hz": board.fps,
            "made_from": version,
            "version_after": event_version(bound),
        },
    )
