"""The grounds of an ablation: places, the runs on them, and the trials that an arm may spend."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import FloatArray, Pose2
from ssp_core.motion.state_series import Series
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import Limits, LinkDisturbance, RunSpec
from ssp_core.run_file.participants import Driver, ElapsedTime, Hold, ParticipantSpec, TriggerSpec
from ssp_core.run_file.road import Road
from ssp_core.vocabulary import Verdict
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.compile.area import OperatingArea
from ssp_scenario_manager.compile.compiler import load_area
from ssp_scenario_manager.compile.place import road_of
from ssp_scenario_manager.compile.task import PlaceLink
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block, BlockLane, Library, conflict_areas, segment_of
from ssp_scenario_manager.run.in_process import InProcessResult, run_in_process
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from ssp_scenario_manager.scenarios.values import thresholds_of

# Sessions that an arm may spend on a place before it must name its run.
BUDGET = 24
# An answer that is tried later counts where its error is below this share of the best before it.
BETTER = 0.95
# Of everybody's positioning, in each arm's sessions.
NOISE = LinkDisturbance(position_noise_m=0.02, speed_noise_mps=0.02)
# The VUT of a realisation is so much slower or faster than planned, drawn evenly.
VUT_SPREAD = 0.05
SOURCE_PLACE = "the source's own place"
# The clip shows its road up to the horizon; a session needs room to begin and end at a standstill.
_SOURCE_ROOM_M = 400.0
_SEED_OF_SPREAD = 33


class NoRun(Exception):
    """The reason why an arm makes no run for a place, for people."""


@dataclass(frozen=True)
class Frame:
    """The part of a run that judge and place fix, alike in all arms; no arm reads it.

    Args:
        fields: of the run file.
        initiator: whose trigger the run must have.
    """

    fields: dict[str, Any]
    initiator: str


@dataclass(frozen=True)
class Ground:
    """A place, as each arm is given it.

    Args:
        name: for people.
        area: site or map, without surroundings.
        limits: Ω_safe, alike in all arms.
    """

    name: str
    area: OperatingArea
    limits: Limits

    @property
    def blocks(self) -> tuple[Block, ...]:
        return self.area.library.blocks


@dataclass(frozen=True)
class ArmRun:
    """An arm's answer for a place: what a session needs of it.

    Args:
        since_s: session time at which the observed part begins, for an initiator without trigger.
    """

    block: Block
    vut: ParticipantSpec
    driver: Driver
    targets: tuple[ParticipantSpec, ...]
    triggers: tuple[TriggerSpec, ...]
    since_s: float


def ground_of(site: str | None, map_path: Path | None, event: Event) -> Ground:
    """Return a site or a map without its surroundings.

    Raises:
        InputError: it isn't valid.
    """
    area, _ = load_area(site, map_path)
    if area.site is not None:
        blocks = [block.model_copy(update={"traffic": []}) for block in area.site.blocks]
        area = replace(area, site=area.site.model_copy(update={"blocks": blocks}))
    return Ground(area.name, area, area.limits(event))


def source_ground(road: Road, event: Event) -> Ground:
    """Return the place that the source shows, with its road led on straight at both ends."""
    line = ReferenceLine.of_road(road)
    if line.is_straight:
        origin = line.pose(min(0.0, road.length_m - _SOURCE_ROOM_M) / 2.0)
        length_m = max(_SOURCE_ROOM_M, road.length_m)
        piece = line.pieces[0].model_copy(update={"length_m": length_m})
        line = ReferenceLine(Pose2(origin.x_m, origin.y_m, origin.yaw_rad), [piece])
    lanes = tuple(
        BlockLane(lane.y_m, lane.width_m, lane.direction == "forward", f"lane {i}")
        for i, lane in enumerate(sorted(road.lanes, key=lambda lane: lane.y_m))
    )
    permitted = frozenset({"keep_lane", "stop", "crossing"})
    if sum(lane.forward for lane in lanes) > 1:
        permitted |= {"lane_change_left", "lane_change_right"}
    sides = ("sidewalk" if w > 0 else "kerb" for w in (road.sidewalk_left_m, road.sidewalk_right_m))
    left, right = sides
    block = Block(
        block_id="source",
        line=line,
        lanes=lanes,
        road_type="urban",
        segment=segment_of(line),
        left_boundary=left,  # type: ignore[arg-type]  # one of two words
        right_boundary=right,  # type: ignore[arg-type]  # one of two words
        sidewalk_left_m=road.sidewalk_left_m,
        sidewalk_right_m=road.sidewalk_right_m,
        permitted=permitted,
        conflict_areas=conflict_areas(line.length_m, lanes, permitted),
    )
    library = Library(SOURCE_PLACE, "", "opendrive", (block,))
    link = PlaceLink(kind="opendrive", name=SOURCE_PLACE, sha256="")
    area = OperatingArea(link, library, None, None, SOURCE_PLACE)
    return Ground(SOURCE_PLACE, area, area.limits(event))


def frame_of(event: Event, version: str) -> Frame:
    """Return what judge and executor need of an event, whatever the arm."""
    kind = KINDS[event.interaction.type]
    return Frame(
        {
            "schema_": "ssp.run/1",
            "run_id": event.name,
            "scenario": event.name,
            "interaction": event.interaction.type,
            "observable": kind.observable,
            "initiator": event.interaction.initiator,
            "domain": "simulation",
            "stand_in": False,
            "event_version": version,
            "thresholds": thresholds_of(event),
            "mode": "lockstep",
        },
        event.interaction.initiator,
    )


def run_of(frame: Frame, ground: Ground, answer: ArmRun) -> RunSpec:
    """Return the run of an arm's answer, with what judge and place fix."""
    triggers = list(answer.triggers)
    if all(trigger.object_id != frame.initiator for trigger in triggers):
        # A session judges the event of an initiator that has a trigger; this one sends nothing.
        triggers.append(
            TriggerSpec(
                id=f"{frame.initiator}_goes_on",
                condition=ElapsedTime(type="elapsed_time", after_s=round(answer.since_s, 3)),
                object_id=frame.initiator,
                manoeuvre=Hold(kind="hold"),
            )
        )
    area = ground.area
    run = RunSpec(
        **frame.fields,
        site=ground.name,
        site_version=area.link.sha256,
        seed=1,
        road=road_of(answer.block),
        geofence=area.geofence(answer.block),
        vut=answer.vut,
        driver=answer.driver,
        targets=list(answer.targets),
        triggers=triggers,
        limits=ground.limits,
        camera=None,
        look=area.look,
    )
    return executed(run)


def executed(run: RunSpec) -> RunSpec:
    """Return a run as each arm's is executed: without camera, surroundings and passing order."""
    update: dict[str, Any] = {"camera": None, "traffic": [], "passing": None, "disturbance": NOISE}
    return run.model_copy(update=update)


def varied(run: RunSpec, seed: int) -> RunSpec:
    """Return the realisation of a seed: another VUT speed and other noise, alike in all arms.

    Args:
        run: as the arm tuned it.
        seed: of the realisation; 0: nothing is varied.
    """
    share = share_of(seed)
    cruise_mps = min(run.driver.cruise_mps * (1.0 + share), 0.99 * run.limits.speed_mps)
    vut = run.vut
    if vut.approach is not None:
        approach = vut.approach.model_copy(update={"cruise_mps": cruise_mps})
        vut = vut.model_copy(update={"approach": approach})
    driver = run.driver.model_copy(update={"cruise_mps": cruise_mps})
    return run.model_copy(update={"seed": seed, "driver": driver, "vut": vut})


def share_of(seed: int) -> float:
    """Return by which share the VUT of a seed is faster than planned."""
    if seed == 0:
        return 0.0
    share = np.random.default_rng([seed, _SEED_OF_SPREAD]).uniform(-VUT_SPREAD, VUT_SPREAD)
    return round(float(share), 4)


@dataclass(frozen=True)
class Trial:
    """A session of a run.

    Args:
        series: true states of VUT and object targets, session time.
        refused: why its objects didn't take their motion, or it never began; empty: they did.
    """

    result: InProcessResult
    series: Series
    refused: str

    @property
    def penalty_m(self) -> float:
        """Return by how much a trial is worse that a limit of the place ended, as any arm sees."""
        return _UNSAFE_M if self.result.verdict is Verdict.FAILED_SAFETY else 0.0


# Of a motion that can't be driven there, whatever event comes of it.
_NOT_DRIVEN = (Verdict.NONE, Verdict.ABORTED, Verdict.INVALID_HARNESS)
# So much worse than any departure is a trial that a limit ended.
_UNSAFE_M = 1000.0


def session(run: RunSpec) -> Trial:
    """Execute a run in this process."""
    result, record = run_in_process(run)
    series = [
        (ns_to_seconds(report.now_ns), {state.object_id: state for state in report.truths})
        for report in record.reports
        if report.running
    ]
    refused = ""
    if result.verdict in _NOT_DRIVEN or not series:
        refused = result.reasons[0] if result.reasons else "the session never began"
    return Trial(result, series, refused)


class Trials:
    """The tuning budget of an arm on a place, spent session by session."""

    def __init__(self, frame: Frame, ground: Ground, budget: int = BUDGET) -> None:
        self._frame, self._ground = frame, ground
        self.left = budget

    def run(self, answer: ArmRun) -> Trial:
        """Execute an arm's answer.

        Raises:
            NoRun: the budget is spent.
        """
        if self.left <= 0:
            raise NoRun("its tuning budget is spent")
        self.left -= 1
        return session(run_of(self._frame, self._ground, answer))


Error = Callable[[ArmRun, Trial], float]


def best_of(trials: Trials, runs: Iterable[ArmRun], error: Error, enough_m: float) -> ArmRun:
    """Return the answer whose executed motion departs least from what the arm was given.

    Args:
        trials: the budget.
        runs: in the order in which they are tried.
        error: of an answer and its trial, m.
        enough_m: an error at which nothing further is tried.

    Raises:
        NoRun: none could be driven; the reason is the first one's.
    """
    best: tuple[float, ArmRun] | None = None
    why = ""
    for answer in runs:
        if trials.left <= 0:
            break
        trial = trials.run(answer)
        if trial.refused:
            why = why or trial.refused
            continue
        error_m = error(answer, trial)
        if best is None or error_m < BETTER * best[0]:
            best = error_m, answer
        if error_m <= enough_m:
            break
    if best is None:
        raise NoRun(why or "no lane of it has room for the motion")
    return best[1]


def times_and_places(series: Series, object_id: str) -> FloatArray:
    """Return times, x and y of an object, shape (3, n)."""
    rows = [(t, now[object_id].x_m, now[object_id].y_m) for t, now in series if object_id in now]
    track: FloatArray = np.array(rows).T
    return track


VUT = VUT_ID
