"""Policies behind an EgodriverService in driven runs, over gRPC on loopback."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from carla_driver_interface import protocol as proto
from carla_driver_interface.policies import load_policy
from carla_driver_interface.service import EgodriverServicer
from click.testing import CliRunner

from ssp_core.errors import InputError
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.latency import Latency
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Verdict
from ssp_core.world.driver import driver_options, try_driver
from ssp_eval.evaluate.driving import bridge_model
from ssp_scenario_manager.cli.loop import loop
from ssp_scenario_manager.closed_loop.answers import answers_of
from ssp_scenario_manager.closed_loop.campaigns.cards import seal_cards
from ssp_scenario_manager.closed_loop.campaigns.plan_file import CampaignDriver, load_plan
from ssp_scenario_manager.closed_loop.campaigns.runs import Job, rows_of
from ssp_scenario_manager.closed_loop.outcomes.outcome import Outcome, outcome_of
from ssp_scenario_manager.closed_loop.single_run.single import named_driver, next_start, parse_drive
from ssp_scenario_manager.closed_loop.starts.start import Start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import InProcessResult, Record, run_in_process
from ssp_vla_bridge.egodriver.policy import BridgePolicy
from ssp_vla_bridge.egodriver.server import Listening
from ssp_vla_bridge.egodriver.server import serving as serving_bridge
from tests.support.models.egodrivers import SMALL, Straight, nobody, serving

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
    patient = {"backend": "egodriver", "url": url, "deadline_s": 600.0}
    options = driver_options("policy", {**patient, **given})
    return start.driven_by("policy", options, Latency(latency_s))


def drive(run: RunSpec, start: Start) -> tuple[Outcome, InProcessResult, Record]:
    result, record = run_in_process(run)
    assert run.driven is not None
    return outcome_of(run, run.driven, result, record, start.twin), result, record


@pytest.mark.parametrize("event", ["cut_in", "vru_crossing"])
def test_the_packages_policies_drive_to_a_verdict(
    event: str, cut_in: Start, tmp_path: Path
) -> None:
    start = cut_in if event == "cut_in" else start_of(event, tmp_path / event)
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
        answered = [one.effective_answer for one in drives if one.effective_answer is not None]
        assert len(answered) > 20
        assert not [one.refused for one in answered if one.refused]


# Its plan depends on each bit of what it is shown.
PROBE = """
import hashlib


def probe(request):
    seen = repr((request.history, request.camera, [frame.jpeg for frame in request.frames],
                 request.request_id, request.stamp_ns))
    share = int(hashlib.sha256(seen.encode()).hexdigest()[:8], 16) / 16.0**8
    v = request.history[-1].speed_mps * (1.0 - 0.01 * share)
    return "I look.", [(0.5 * v * k, 0.01 * share * k) for k in range(11)]
"""


def test_a_bridge_behind_a_server_drives_to_the_same_bytes(cut_in: Start, tmp_path: Path) -> None:
    (tmp_path / "probing.py").write_text(PROBE)
    function = {"function": "probing:probe", "folder": str(tmp_path)}
    options = driver_options("mine", {"backend": "python", **function})
    direct = drive(cut_in.driven_by("mine", options, Latency(0.2)), cut_in)
    policy = BridgePolicy(bridge_model("mine", options))
    with serving_bridge(policy, "alpasim", Listening(port=0)) as url:
        served = drive(run_of(cut_in, url, 0.2), cut_in)
    assert direct[0] == served[0]
    assert [one.truths for one in direct[2].reports] == [one.truths for one in served[2].reports]
    plans = [_plans(one[2]) for one in (direct, served)]
    assert plans[0] == plans[1]
    assert len(plans[0]) > 20


def _plans(record: Record) -> list[Any]:
    drives = [one.drive for one in record.reports if one.drive is not None]
    answered = [one.effective_answer for one in drives if one.effective_answer is not None]
    return [(one.stamp_ns, one.answer.trajectory, one.answer.text) for one in answered]


def test_repeats_have_seeds_of_their_own_and_runs_have_names_of_their_own(
    cut_in: Start, tmp_path: Path
) -> None:
    """A policy that samples by its seed shows its spread (METHOD 8.7).

    The event and its event-free twin share a seed: nothing marks either (METHOD 8.2).
    """

    class Ending(Straight):
        def answer(self, request: Any) -> Any:
            return proto.DriveResponse(terminate_session=True)

    servicer = Ending()
    text = json.dumps({"event": "cut_in", "kind": "critical", **cut_in.sealed()})
    with serving(servicer) as url:
        patient = {"backend": "egodriver", "url": url, "deadline_s": 600.0}
        policy = CampaignDriver(driver="mine", options=driver_options("mine", patient))
        job = Job(text, policy, (Latency(0.2),), repeats=2, seed=SEED, folder=tmp_path)
        done = rows_of(job)
        # A campaign that goes on asks nothing again.
        assert rows_of(job) == done
    assert len(done.rows) == 2
    begun = servicer.sent("start_session")
    seeds = [one.random_seed for one in begun]
    first, second = (Driven.model_validate(_driven(cut_in, k)).sampling_seed(SEED) for k in (0, 1))
    assert seeds == [first, first, second, second]
    assert first != second
    assert len({one.session_uuid for one in begun}) == 4


def _driven(start: Start, repeat: int) -> dict[str, Any]:
    driven = start.driven_by("mine", {}, Latency(0.2), repeat=repeat).driven
    assert driven is not None
    return driven.model_dump(mode="json")


def test_a_run_is_driven_again_without_its_server(cut_in: Start) -> None:
    with serving(EgodriverServicer(load_policy("constant_speed"), "alpasim")) as url:
        run = run_of(cut_in, url, 0.2)
        _, _, first = drive(run, cut_in)
    assert run.driven is not None
    _, again = run_in_process(run, answers=answers_of(run.driven, first))
    assert [one.truths for one in first.reports] == [one.truths for one in again.reports]


def test_an_address_alone_names_a_driver_and_its_connection_is_asked_for_by_name() -> None:
    with serving(Straight()) as url:
        drive_of = parse_drive(url, "fixed:0.2")
        assert parse_drive(f'mine={{"backend": "egodriver", "url": "{url}"}}', "zero").options == (
            drive_of.options
        )
        assert parse_drive(url, "zero", insecure=True).options["egodriver"]["insecure"]
    assert (drive_of.driver, drive_of.options["egodriver"]["url"]) == ("egodriver", url)
    assert not drive_of.options["egodriver"]["insecure"]
    refused = "can't be loaded: get_version failed: UNAVAILABLE"
    with nobody() as silent:
        unheard = parse_drive(silent, "zero")
        with pytest.raises(InputError, match=refused):
            try_driver(unheard.driver, unheard.options)
    with pytest.raises(InputError, match="deadline_s"):
        driver_options("m", {"backend": "egodriver", "url": url, "timeout_s": 1.0})


def test_an_option_of_a_driver_that_stands_twice_is_refused() -> None:
    for given, why in (
        ('{"ttc_s": 1.4, "ttc_s": 9}', "key 'ttc_s' stands twice"),
        ('{"ttc_s": NaN}', "NaN is no number"),
    ):
        with pytest.raises(InputError, match=f"--drive aeb: is not valid JSON: {why}"):
            named_driver(f"aeb={given}")


def test_a_campaign_takes_a_policy_by_its_address(tmp_path: Path) -> None:
    """``ssp loop --drive`` names it as ``ssp run --drive`` does, and refuses what it refuses."""
    (tmp_path / "plan.yaml").write_text("{schema: ssp.loop/1, events: [cut_in]}")
    with serving(Straight()) as url:
        named = [CampaignDriver(driver=n, options=o) for n, o in [named_driver(url)]]
        (one,) = load_plan(tmp_path / "plan.yaml", named).drivers
        assert (one.driver, one.options) == ("egodriver", parse_drive(url, "zero").options)
        with pytest.raises(InputError, match=r"--drive: stands twice.*give it another name"):
            load_plan(tmp_path / "plan.yaml", named * 2)
    begun = [str(tmp_path / "plan.yaml"), "--out", str(tmp_path / "out")]
    with nobody() as silent:
        said = CliRunner().invoke(loop, [*begun, "--drive", silent])
        assert "can't be loaded: get_version failed: UNAVAILABLE" in str(said.exception)
    said = CliRunner().invoke(loop, [*begun, "--drive", "grpc://192.0.2.1:50051"])
    assert "isn't loopback" in str(said.exception)
    assert not (tmp_path / "out").exists()
    assert CliRunner().invoke(loop, [*begun, "--drive-insecure"]).exit_code == 2
    assert CliRunner().invoke(loop, [*begun, "--again", "1", "--drive", "aeb"]).exit_code == 2


def test_the_card_of_a_policy_says_that_it_sees_the_route(cut_in: Start, tmp_path: Path) -> None:
    """Results with and without it never share a column (METHOD 8.2)."""
    with serving(Straight()) as url:
        plan = {
            "schema": "ssp.loop/1",
            "events": ["cut_in"],
            "drivers": [
                {"driver": "mine", "options": {"backend": "egodriver", "url": url}},
                {"driver": "other", "options": {"backend": "opencv_baseline"}},
            ],
        }
        (tmp_path / "plan.yaml").write_text(yaml.safe_dump(plan))
        read = load_plan(tmp_path / "plan.yaml")
    start = {
        "run": cut_in.run.model_dump(mode="json", by_alias=True),
        "frame_period_s": 0.1,
        "camera": None,
    }
    cards = {one["driver"]: one for one in seal_cards(tmp_path, read, [start])}
    assert [cards[name]["route_m"] for name in ("mine", "other", "aeb")] == [80.0, None, 80.0]
    assert (cards["mine"]["interface"], cards["mine"]["timeout_s"]) == ("egodriver", 10.0)
