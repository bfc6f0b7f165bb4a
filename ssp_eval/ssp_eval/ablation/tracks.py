"""Arm ``tracks``: direct compilation of the observed tracks, without structure.

The tracks are laid onto the best-fitting lane by one rigid motion and played by the clock. The VUT
drives at its first observed speed, led by the driver that it has in every arm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.motion.state_series import states_of
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.world.reference_line import NotOneToOne
from ssp_eval.ablation.ground import (
    BETTER,
    VUT,
    ArmRun,
    Ground,
    NoRun,
    Trial,
    Trials,
    times_and_places,
)
from ssp_eval.ablation.placing import (
    HEADWAYS_S,
    Body,
    Placement,
    approach_mps2,
    placements,
    ramp_s,
    run_up_s,
    slower_by,
    timed_motion,
    vut_of,
)
from ssp_eval.ablation.source import STANDS_MPS, Track, Tracks
from ssp_scenario_manager.maps.block import Block, BlockLane
from ssp_scenario_manager.scenarios.block_places import ahead_of
from ssp_scenario_manager.scenarios.motions import driver_travel

_ENOUGH_M = 0.3


@dataclass(frozen=True)
class _PlacedTracks:
    """Tracks on a place.

    Args:
        share: of the observed speeds.
        since_s: session time of the first observed instant.
        way_m: of the VUT until then.
    """

    share: float
    since_s: float
    way_m: float


def by_tracks(tracks: Tracks, ground: Ground, trials: Trials) -> ArmRun:
    """Return the answer of direct compilation for a place.

    Raises:
        NoRun: the tracks fit onto no lane of it, or can't be driven there.
    """
    candidates = placements(ground, _need_m(tracks, ground), _bodies(tracks, ground))
    best: tuple[float, ArmRun] | None = None
    why = ""
    for number, placement in enumerate(candidates):
        laid = _place_tracks(tracks, ground, placement.block)
        headways = HEADWAYS_S if number == 0 or best is None else (best[1].driver.headway_s,)
        for headway_s in headways:
            try:
                error_m, answer = _tuned(tracks, ground, placement, laid, headway_s, trials)
            except NoRun as error:
                why = why or str(error)
                continue
            if best is None or error_m < BETTER * best[0]:
                best = error_m, answer
        if best is not None and best[0] <= _ENOUGH_M:
            break
    if best is None:
        raise NoRun(why)
    return best[1]


def _place_tracks(tracks: Tracks, ground: Ground, block: Block) -> _PlacedTracks:
    speeds = [tracks.vut.speed_mps, *(one.speed_mps for one in tracks.others)]
    share = slower_by(ground, block, speeds)
    cruise_mps = share * float(tracks.vut.speed_mps[0])
    a = approach_mps2(tracks.vut.object_class, ground.limits)
    since_s = run_up_s(cruise_mps, a)
    for one in tracks.others:
        speed = share * float(one.speed_mps[0])
        if speed > STANDS_MPS:
            its = approach_mps2(one.object_class, ground.limits)
            since_s = max(since_s, ramp_s(speed, its) + 2.0)
    return _PlacedTracks(share, since_s, driver_travel(cruise_mps, a, since_s)[0])


def _need_m(tracks: Tracks, ground: Ground) -> float:
    way = np.hypot(np.diff(tracks.vut.x_m), np.diff(tracks.vut.y_m)).sum()
    return float(way) + max(_place_tracks(tracks, ground, block).way_m for block in ground.blocks)


def _map_places(
    tracks: Tracks, one: Track, block: Block, lane: BlockLane, start_s_m: float, laid: _PlacedTracks
) -> FloatArray:
    """Return a track in frame map, shape (n, 2): the VUT's ends lie on the lane, or beside it."""
    vut = tracks.vut
    begin_m = ahead_of(block, start_s_m, laid.way_m, lane.y_m)
    chord = np.array((vut.x_m[-1] - vut.x_m[0], vut.y_m[-1] - vut.y_m[0]))
    length_m = float(np.hypot(*chord))
    first = np.array(block.line.to_map(begin_m, lane.y_m))
    last = np.array(block.line.to_map(begin_m + length_m, lane.y_m))
    turn = np.arctan2(*(last - first)[::-1]) - np.arctan2(chord[1], chord[0])
    cos, sin = np.cos(turn), np.sin(turn)
    dx, dy = one.x_m - vut.x_m[0], one.y_m - vut.y_m[0]
    return np.stack((first[0] + cos * dx - sin * dy, first[1] + sin * dx + cos * dy), axis=1)


def _bodies(tracks: Tracks, ground: Ground) -> Callable[[Block, BlockLane, float], list[Body]]:
    laid = {block.block_id: _place_tracks(tracks, ground, block) for block in ground.blocks}

    def bodies(block: Block, lane: BlockLane, start_s_m: float) -> list[Body]:
        end_bodies = []
        for one in (tracks.vut, *tracks.others):
            places = _map_places(tracks, one, block, lane, start_s_m, laid[block.block_id])
            for k, near in ((0, 1), (-1, -2)):
                stands = float(one.speed_mps[k]) < STANDS_MPS
                if stands and k != 0:
                    continue
                s_m, l_m = block.line.to_local(*places[k])
                s_near, _ = block.line.to_local(*places[near])
                forward = (s_m - s_near if k else s_near - s_m) >= 0.0
                end_bodies.append(Body(one.object_class, l_m, forward, stands))
        return end_bodies

    return bodies


def _arm_run(
    tracks: Tracks, ground: Ground, placement: Placement, laid: _PlacedTracks, headway_s: float
) -> ArmRun:
    block, lane = placement.block, placement.lane
    cruise_mps = laid.share * float(tracks.vut.speed_mps[0])
    vut, driver = vut_of(placement, cruise_mps, headway_s, ground.limits)
    targets = []
    for one in tracks.others:
        try:
            places = _map_places(tracks, one, block, lane, placement.start_s_m, laid)
        except NotOneToOne as error:
            raise NoRun(str(error)) from error
        times = laid.since_s + tracks.times_s / laid.share
        start, motion = timed_motion(times, places, one.object_class, ground, block)
        if motion is None:
            ahead = float(tracks.vut.yaw_rad[0])
            turn = float(vut.start.yaw_rad) - ahead
            start = start.model_copy(update={"yaw_rad": float(one.yaw_rad[0]) + turn})
        targets.append(
            ParticipantSpec(
                id=one.object_id,
                object_class=one.object_class.word,
                start=start,
                approach=motion,
            )
        )
    return ArmRun(block, vut, driver, tuple(targets), (), laid.since_s)


def _tuned(
    tracks: Tracks,
    ground: Ground,
    placement: Placement,
    laid: _PlacedTracks,
    headway_s: float,
    trials: Trials,
) -> tuple[float, ArmRun]:
    """Play tracks on a placement, and once more at the time at which the VUT was there.

    Returns:
        The rms distance of what was executed from what was observed, m, and the answer.
    """
    answer = _arm_run(tracks, ground, placement, laid, headway_s)
    trial = trials.run(answer)
    if trial.refused:
        raise NoRun(trial.refused)
    error_m = _error_m(tracks, placement, laid, trial)
    late_s = _late_s(placement, laid, trial)
    if late_s is None or abs(late_s) < 0.02 or trials.left <= 0:
        return error_m, answer
    moved = replace(laid, since_s=laid.since_s + late_s)
    again = _arm_run(tracks, ground, placement, moved, headway_s)
    trial = trials.run(again)
    if trial.refused:
        return error_m, answer
    error_again_m = _error_m(tracks, placement, moved, trial)
    return (error_again_m, again) if error_again_m < error_m else (error_m, answer)


def _late_s(placement: Placement, laid: _PlacedTracks, trial: Trial) -> float | None:
    """Return by how much later than planned the VUT is where it was seen first."""
    block, lane = placement.block, placement.lane
    x, y = block.line.to_map(ahead_of(block, placement.start_s_m, laid.way_m, lane.y_m), lane.y_m)
    states = states_of(trial.series, VUT)
    times, xs, ys = times_and_places(trial.series, VUT)
    nearest = int(np.argmin(np.hypot(xs - x, ys - y)))
    state = states[nearest]
    if state.speed_mps < 1.0:
        return None
    ahead_m = (x - state.x_m) * np.cos(state.yaw_rad) + (y - state.y_m) * np.sin(state.yaw_rad)
    return float(times[nearest] + ahead_m / state.speed_mps - laid.since_s)


def _error_m(tracks: Tracks, placement: Placement, laid: _PlacedTracks, trial: Trial) -> float:
    squares = []
    for name, one in ((VUT, tracks.vut), *((one.object_id, one) for one in tracks.others)):
        targets_m = _map_places(
            tracks, one, placement.block, placement.lane, placement.start_s_m, laid
        )
        times, xs, ys = times_and_places(trial.series, name)
        at = laid.since_s + tracks.times_s / laid.share
        overlap = at <= times[-1]
        x, y = np.interp(at[overlap], times, xs), np.interp(at[overlap], times, ys)
        squares.append((x - targets_m[overlap, 0]) ** 2 + (y - targets_m[overlap, 1]) ** 2)
    together = np.concatenate(squares)
    if not len(together):
        return np.inf
    return float(np.sqrt(together.mean())) + trial.penalty_m
