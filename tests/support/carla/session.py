"""Sessions in one process whose bodies a CARLA server moves.

``python -m tests.support.carla.session FOLDER`` reads JSON from standard input: a list of
event, map and address of a server. Events are compiled for the site boulevard, whose ground the
map's stands for. It prints JSON: for each session its verdict and reasons, its record of the
server, and the largest tracking error of each target, m along and beside; or the error that ended
it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ssp_core.carla.acceptance import opendrive_sha256, read_map
from ssp_core.carla.address import parse_address
from ssp_core.errors import PeerError
from ssp_core.world.plant import StepReport
from ssp_ot_controller.in_process import InProcessPlant
from ssp_ot_controller.sil.carla_bodies import CarlaBodies
from ssp_ot_controller.sil.scene import NoTraffic
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.compile.task import TASK_FOLDER, load_task
from ssp_scenario_manager.run.in_process import Record, judge_session
from ssp_scenario_manager.run.in_process_session import InProcessSession
from ssp_scenario_manager.run.sweep import for_one_process


def session(folder: Path, event: str, map_file: str, address: str) -> dict[str, Any]:
    """One session, and what came of it."""
    if not folder.exists():
        prepare_run(event, "boulevard", folder, seed=11, mode="lockstep")
    run = for_one_process(load_task(folder / TASK_FOLDER).run)
    told: dict[str, Any] = {}

    def tell(record: Mapping[str, Any]) -> None:
        told["record"] = dict(record)

    wanted = opendrive_sha256(read_map(map_file))
    seen, bodies = Record(), None
    try:
        bodies = CarlaBodies(run, parse_address(address, "address"), wanted, tell)
        plant = InProcessPlant(run, NoTraffic(), ExitStack(), bodies)
        ended = InProcessSession(run, plant, seen.reports.append)
        ended.run()
        outcome, _ = judge_session(run, ended, seen)
        told["verdict"], told["reasons"] = outcome.verdict.name.lower(), list(outcome.reasons)
    except PeerError as error:
        told["error"] = str(error)
    finally:
        told["left"] = [] if bodies is None else bodies.close()
    told["tracking_m"] = _tracking_m(seen.reports)
    return told


def _tracking_m(reports: list[StepReport]) -> dict[str, tuple[float, float]]:
    found: dict[str, tuple[float, float]] = {}
    for state in (state for report in reports for state in report.target_states):
        along, beside = found.get(state.object_id, (0.0, 0.0))
        found[state.object_id] = (
            max(along, abs(state.error_longitudinal_m)),
            max(beside, abs(state.error_lateral_m)),
        )
    return found


if __name__ == "__main__":
    cases = json.load(sys.stdin)
    print(json.dumps([session(Path(sys.argv[1]) / one[0], *one) for one in cases]))
