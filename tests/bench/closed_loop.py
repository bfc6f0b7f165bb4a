"""Closed-loop campaigns: a row, and what a campaign of one driver without a camera takes.

A row is one driver on one start, with its event-free twin, as in ``runs.csv``, with outcome and
needless braking. A campaign draws its starts, too, and leaves a bag of each run. The lower bound
moves the VUT and the object as points, as many steps. All times are processor time.
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path

from measure import report
from sil_in_process import points_alone_s

from ssp_core.run_file.latency import Latency
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.closed_loop.campaigns.plan_file import CampaignDriver, LoopPlan
from ssp_scenario_manager.closed_loop.campaigns.runs import Job, drive_start, jobs_of, rows_of
from ssp_scenario_manager.closed_loop.campaigns.seal import draw_starts
from ssp_scenario_manager.closed_loop.single_run.single import next_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event

ROUNDS = 5
LATENCY = Latency(0.5)


EVENTS = ("cut_in", "vru_crossing", "lead_braking", "slow_lead")
LATENCIES = ("zero", "fixed:0.1", "fixed:0.2", "fixed:0.5", "fixed:1", "fixed:2")
# Of the campaign that is judged; one start of each event is driven here.
STARTS, CORES, MOST_MIN = 20, 2, 30.0


def campaign() -> None:
    """A driver on one start of each event at each latency, for as many starts as it asks for."""
    plan = LoopPlan.model_validate(
        {
            "schema": "ssp.loop/1",
            "events": EVENTS,
            "latencies": LATENCIES,
            "starts": 1,
            "others": 0,
        }
    )
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        starts = draw_starts(plan, Path(folder), 1, lambda _: None)
        jobs = [
            job
            for job in jobs_of(plan, starts, Path(folder), "all")
            if job.driver.driver == "constant_velocity"
        ]
        count = sum(len(rows_of(job).rows) for job in jobs)
        took_s = time.process_time() - began
    runs = [RunSpec.model_validate(one["run"]) for one in starts]
    # In the event and in its event-free twin, up to T_end.
    simulated_s = sum(2.0 * len(LATENCIES) * one["end_s"] for one in starts)
    bound_s = simulated_s * max(points_alone_s(run) for run in runs)
    scale = STARTS / CORES / 60.0
    report(
        "closed_loop: 4 events, 6 latencies, 20 starts",
        took_s * scale,
        bound_s * scale,
        "min on two cores",
        f"constant_velocity, from {count} rows of {len(starts)} starts, their draws and bags",
        lower=True,
        ratio_limit=2500.0,
        limit=MOST_MIN,
    )


def row() -> None:
    """A row of a campaign."""
    with tempfile.TemporaryDirectory() as folder:
        run = prepare_run("cut_in", "boulevard", Path(folder) / "run", seed=1, mode="lockstep")
    start = next_start(run, load_event("cut_in")[0], 1, LATENCY.seconds, lambda _: None)
    driver = CampaignDriver(driver="constant_velocity")
    drives = [drive_start(start, driver, LATENCY, event=event) for event in (True, False)]
    session_s = sum(len(drove.record.reports) * run.step_s for drove in drives)
    kept = {"event": "cut_in", "kind": "critical", **start.sealed()}
    job = Job(json.dumps(kept), driver, (LATENCY,), 1, 1)
    rows_of(job)  # the start's twins are driven once for all drivers, and are there now

    def row_s() -> float:
        began = time.process_time()
        rows_of(job)
        return time.process_time() - began

    both = [(row_s(), session_s * points_alone_s(start.run)) for _ in range(ROUNDS)]
    ours_s, bound_s = map(min, zip(*both, strict=True))
    report(
        "closed_loop: a row of a campaign",
        ours_s,
        bound_s,
        "s of a core",
        f"cut_in, constant_velocity at {LATENCY.words}, {session_s:.0f} s simulated, best of "
        f"{ROUNDS}",
        lower=True,
        ratio_limit=1050.0,
    )


def main() -> None:
    row()
    campaign()


if __name__ == "__main__":
    main()
