"""Policies behind an EgodriverService in driven runs, over gRPC on loopback."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from carla_driver_interface.policies import load_policy
from carla_driver_interface.service import EgodriverServicer

from ssp_core.run_file.latency import Latency
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Verdict
from ssp_core.world.driver import driver_options
from ssp_scenario_manager.closed_loop.outcome import Outcome, outcome_of
from ssp_scenario_manager.closed_loop.single import next_start
from ssp_scenario_manager.closed_loop.start import Start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import InProcessResult, Record, run_in_process
from tests.support.egodrivers import SMALL, serving

SEED = 1


def start_of(event: str, folder: Path) -> Start:
    compiled = prepare_run(event, "boulevard", folder, seed=SEED, mode="lockstep")
    small = compiled.model_copy(update={"camera": SMALL})
    said: list[str] = []
    return next_start(small, load_event(event)[0], SEED, 0.5, said.append)


@pytest.fixture(scope="module")
def cut_in(tmp_path_factory: pytest.TempPathFactory) -> Start:
    return start_of("cut_in", tmp_path_factory.mktemp("driven") / "cut_in")


def run_of(start: Start, url: str, latency_s: float, **given: Any) -> RunSpec:
    options = driver_options("policy", {"backend": "egodriver", "url": url, **given})
    return start.driven_by("policy", options, Latency(latency_s))


def drive(run: RunSpec, start: Start) -> tuple[Outcome, InProcessResult, Record]:
    result, record = run_in_process(run)
    assert run.driven is not None
    return outcome_of(run, run.driven, result, record, start.twin), result, record


@pytest.mark.parametrize("event", ["cut_in", "vru_crossing", "lead_braking"])
def test_the_packages_policies_drive_to_a_verdict(event: str, tmp_path: Path) -> None:
    start = start_of(event, tmp_path / event)
    hand_over = min(start.twin.values(), key=lambda s: abs(s.stamp_ns / 1e9 - start.hand_over_s))
    for name in ("constant_speed", "route_follower"):
        policy = load_policy(name, cruise_speed_mps=hand_over.speed_mps)
        with serving(EgodriverServicer(policy, "alpasim")) as url:
            outcome, result, record = drive(run_of(start, url, 0.2), start)
        # Neither reacts to anybody; those who follow a route are slower where it bends.
        kinds = ("collision", "evaded", "avoided") if name == "route_follower" else ("collision",)
        assert outcome.kind in kinds, outcome
        assert result.verdict == Verdict.VALID
        drives = [one.drive for one in record.reports if one.drive is not None]
        answered = [one.answered for one in drives if one.answered is not None]
        assert len(answered) > 20
        assert not [one.refused for one in answered if one.refused]
