"""A model drives the VUT in one process, by the frames of a 720p camera, and costs nothing itself.

The lower bound draws the same frames from the same states, and steps the same session with a VUT
that is commanded: without questions, a model's process, adapter and plans.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from measure import report

from ssp_core.run_file.driven import NO_RESPONSE
from ssp_core.run_file.latency import ZERO_LATENCY
from ssp_core.run_file.model import Camera, RunSpec
from ssp_core.world.driver import driver_options
from ssp_ot_controller.driving.frames import QuestionFrames
from ssp_scenario_manager.closed_loop.starts.start import Start, make_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import Record, run_in_process

ROUNDS = 3
# Times real time: a model's frames mustn't make a campaign slower than driving would be.
LEAST_X = 1.5
CAMERA = Camera(width_px=1280, height_px=720, rate_hz=10.0)


def steady(request: Any) -> tuple[str, list[tuple[float, float]]]:
    """Plan at the present speed."""
    v = request.history[-1].speed_mps
    return "", [(0.5 * v * k, 0.0) for k in range(11)]


def start() -> Start:
    """A start of the shipped cut-in."""
    with tempfile.TemporaryDirectory() as folder:
        run = prepare_run("cut_in", "boulevard", Path(folder) / "cut_in", seed=1, mode="lockstep")
    filmed = run.model_copy(update={"camera": CAMERA})
    return make_start(filmed, load_event("cut_in")[0], 1, latency_max_s=0.0)


def driven(run: RunSpec) -> tuple[float, Record]:
    """Times real time, with the start of the model's process."""
    started = time.perf_counter()
    result, record = run_in_process(run)
    return result.session_s / (time.perf_counter() - started), record


def bound(run: RunSpec, of: Start, record: Record) -> float:
    """Times real time of drawing and stepping alone."""
    started = time.perf_counter()
    run_in_process(of.driven_by(NO_RESPONSE, {}, ZERO_LATENCY))
    frames, shown = QuestionFrames(run, 0.9), 0
    for one in record.reports:
        frames.see(one.step, one.now_ns, one.truths)
        if one.drive is not None and one.drive.question is not None:
            # The first question shows what was there before, too.
            count = len(one.drive.question.frames) if not shown else 1
            stamps = len(frames.stamps_ns)
            frames.show(range(stamps - count, stamps))
            shown += count
    return record.reports[-1].now_ns / 1e9 / (time.perf_counter() - started)


def main() -> None:
    made = start()
    options = {
        "backend": "python",
        "function": "sil_driven:steady",
        "folder": str(Path(__file__).parent),
    }
    run = made.driven_by("steady", driver_options("steady", options), ZERO_LATENCY)
    driven(run)  # imports, kernels and the server of models are there now
    found = [driven(run) for _ in range(ROUNDS)]
    rates = [rate for rate, _ in found]
    asked = sum(r.drive is not None and r.drive.question is not None for r in found[0][1].reports)
    report(
        "sil_driven: a model, 720p camera",
        statistics.median(rates),
        max(bound(run, made, found[0][1]) for _ in range(ROUNDS)),
        "x real time",
        f"{asked} questions, median of {ROUNDS}, best {max(rates):.3g}",
        lower=False,
        ratio_limit=2.0,
        limit=LEAST_X,
    )


if __name__ == "__main__":
    main()
