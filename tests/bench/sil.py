"""Sessions in lockstep against the clock: through DDS, with and without a camera.

Five object targets at 50 Hz: the cut-in on the boulevard, with four more that drive along the road
and beside it. The lower bound of what goes through DDS is the same session in one process, which
has the same cores and no messages; with a camera it draws and writes too, one after the other.
"""

from __future__ import annotations

import math
import statistics
import tempfile
import time
from pathlib import Path

from measure import report

from ssp_core.run_file.model import Camera, RunSpec
from ssp_core.run_file.participants import Motion, ParticipantSpec
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectWord, Verdict
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.run.in_process import run_in_process, run_recorded
from ssp_scenario_manager.run.over_dds.session import run_session
from ssp_scenario_manager.run.sweep import for_one_process

ROUNDS = 3
# Objects that are there besides: class, from, to, cruise in m/s.
_OTHERS: tuple[tuple[ObjectWord, tuple[float, float], tuple[float, float], float], ...] = (
    ("car", (110.0, 3.5), (394.0, 3.5), 9.0),
    ("truck", (380.0, 7.0), (20.0, 7.0), 8.0),
    ("cyclist", (120.0, -2.6), (380.0, -2.6), 4.0),
    ("pedestrian", (150.0, 14.5), (250.0, 14.5), 1.4),
)


def one_target() -> RunSpec:
    """The shipped scenario, without its camera."""
    task = compile_task(Request(event="cut_in", target="sumo", site="boulevard")).task
    return task.run.model_copy(update={"run_id": "bench", "camera": None})


def five_targets() -> RunSpec:
    """The shipped scenario with four more object targets that are on their way all the while."""
    run = one_target()
    others = []
    for number, (word, begin, end, cruise_mps) in enumerate(_OTHERS, start=2):
        yaw_rad = math.atan2(end[1] - begin[1], end[0] - begin[0])
        motion = Motion(
            path=[begin, end], cruise_mps=cruise_mps, acceleration_mps2=1.0, deceleration_mps2=1.0
        )
        start = Start(x_m=begin[0], y_m=begin[1], yaw_rad=yaw_rad)
        others.append(
            ParticipantSpec(id=f"ot{number}", object_class=word, start=start, approach=motion)
        )
    return run.model_copy(update={"targets": [*run.targets, *others]})


def through_dds(spec: RunSpec) -> float:
    """Times real time, from the start of the run to its end."""
    with tempfile.TemporaryDirectory() as folder:
        result = run_session(spec, Path(folder), lambda line: None)
    if result.outcome.verdict is not Verdict.VALID:
        raise RuntimeError(f"the session failed: {result.outcome.reasons}")
    return result.session_s / result.running_wall_s


def in_one_process(spec: RunSpec, work_dir: Path) -> float:
    """Times real time, with all that a run of a sweep takes to start."""
    started = time.perf_counter()
    result, _ = run_in_process(spec, work_dir)
    wall_s = time.perf_counter() - started
    if not result.ok:
        raise RuntimeError(f"the run in one process failed: {result.reasons}")
    return result.session_s / wall_s


def recorded_in_one_process(spec: RunSpec) -> float:
    """Times real time, its pictures drawn and its bag written one after the other."""
    spec = for_one_process(spec, camera=True)
    with tempfile.TemporaryDirectory() as folder:
        run_file = Path(folder) / "run.yaml"
        run_file.write_text(spec.model_dump_json(by_alias=True))
        started = time.perf_counter()
        result, _, _ = run_recorded(spec, run_file, Path(folder) / "bag", lambda line: None)
        return result.session_s / (time.perf_counter() - started)


def main() -> None:
    five = five_targets()
    camera = Camera(width_px=1280, height_px=720, rate_hz=10.0)
    filmed = five.model_copy(update={"camera": camera})
    rates: dict[str, list[float]] = {name: [] for name in ("dds", "filmed", "five", "drawn")}
    with tempfile.TemporaryDirectory() as folder:
        in_one_process(five, Path(folder))  # imports, gains and files are there from now on
        for _ in range(ROUNDS):
            rates["five"].append(in_one_process(five, Path(folder)))
            rates["dds"].append(through_dds(five))
            rates["filmed"].append(through_dds(filmed))
            rates["drawn"].append(recorded_in_one_process(filmed))
    unit, size = "x real time", f"{1 / five.step_s:.0f} Hz, median of {ROUNDS}, best "
    middle = {name: statistics.median(found) for name, found in rates.items()}
    best = {name: f"{max(found):.3g}" for name, found in rates.items()}
    report(
        "sil: lockstep through DDS, no camera",
        middle["dds"],
        middle["five"],
        unit,
        f"{len(five.targets)} object targets, {size}{best['dds']}",
        lower=False,
        ratio_limit=4.0,
    )
    report(
        "sil: the same, 720p camera recorded",
        middle["filmed"],
        middle["drawn"],
        unit,
        f"{len(five.targets)} object targets, {size}{best['filmed']}",
        lower=False,
        ratio_limit=1.5,
    )


if __name__ == "__main__":
    main()
