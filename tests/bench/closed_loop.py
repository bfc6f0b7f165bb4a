"""A job of a closed-loop campaign: one driver on one start, with its event-free twin.

Its rows are those of ``runs.csv``, with outcome and needless braking. The lower bound moves the
VUT and the object as points, as many steps. All times are processor time.
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path

from measure import report
from sil_in_process import points_alone_s

from ssp_core.run_file.latency import Latency
from ssp_scenario_manager.closed_loop.plan_file import CampaignDriver
from ssp_scenario_manager.closed_loop.runs import Job, drive_start, rows_of
from ssp_scenario_manager.closed_loop.single import next_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event

ROUNDS = 5
LATENCY = Latency(0.5)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        run = prepare_run("cut_in", "boulevard", Path(folder) / "run", seed=1, mode="lockstep")
    start = next_start(run, load_event("cut_in")[0], 1, LATENCY.seconds, lambda _: None)
    driver = CampaignDriver(driver="constant_velocity")
    drives = [drive_start(start, driver, LATENCY, event=event) for event in (True, False)]
    session_s = sum(len(drove.record.reports) * run.step_s for drove in drives)
    kept = {
        **start.facts(),
        "event": "cut_in",
        "kind": "critical",
        "hash": start.hash,
        "run": start.run.model_dump(mode="json", by_alias=True),
    }
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


if __name__ == "__main__":
    main()
