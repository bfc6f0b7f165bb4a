"""The probe, against a played object in time that is set, and over sockets."""

from __future__ import annotations

import json
import re
import socket
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from ssp_core.errors import InputError
from ssp_core.geodesy import Datum
from ssp_core.geometry import Pose2
from ssp_core.motion.reference import Points
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import Motion
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    Grem,
    Monr,
)
from ssp_ot_controller.bodies.iso22133.probe.clauses import CLAUSES
from ssp_ot_controller.bodies.iso22133.probe.fenced_way import FencedWay
from ssp_ot_controller.bodies.iso22133.probe.steps import ProbeClause, Step
from ssp_ot_controller.bodies.iso22133.probe_report import (
    Outcome,
    ProbeReport,
    Stage,
    cannot_arm,
    honours_start_time,
    load_report,
    stops_on_heartbeat_loss_s,
)
from ssp_ot_controller.rehearsal.iso import iso
from ssp_ot_controller.rehearsal.iso_probe import load_fence, load_motion
from tests.support.iso22133.centre import FENCE, PLACE, S
from tests.support.iso22133.messages import ObjectSockets
from tests.support.iso22133.probed import SIZE, STAGES, Probed, ReorderingLink, with_verdict

C = ControlState
LIMITS = Limits(speed_mps=15.0, acceleration_mps2=4.0)


def report_with(*faults: str, stages: tuple[Stage, ...] = STAGES) -> ProbeReport:
    return _report(faults, stages)


@cache
def _report(faults: tuple[str, ...], stages: tuple[Stage, ...]) -> ProbeReport:
    return Probed(*faults, stages=stages).run()


# -- objects that conform, and others -------------------------------------------------------------


def test_a_conforming_object_passes_every_clause_and_may_be_armed() -> None:
    report = report_with()
    assert with_verdict(report, Outcome.INFO) == {"connect.identity"}
    assert with_verdict(report, Outcome.PASS) == {c.id for c in CLAUSES} - {"connect.identity"}
    assert honours_start_time(report) == pytest.approx(0.0, abs=0.1)
    # It waits for the half second that the OSEM gave before it brakes.
    assert 0.5 < (stops_on_heartbeat_loss_s(report) or 0.0) < 1.0
    assert cannot_arm(report, LIMITS, report.firmware, None) == ()
    assert report.firmware


LISTEN = (Stage.LISTEN,)
CONNECT = (Stage.LISTEN, Stage.CONNECT)


@pytest.mark.parametrize(
    ("fault", "stages", "failed"),
    [
        ("deaf_to_abort@0", STAGES, {"move.abort"}),
        ("deaf_to_silence", STAGES, {"move.heartbeat_loss"}),
        ("early_start", STAGES, {"move.start_time"}),
        ("link_delay=0.4", LISTEN, {"listen.age"}),
        ("fragments", CONNECT, set()),
        ("driving_state=77", STAGES, {"listen.values", "move.running", "move.postrun"}),
        ("driving_state=3", STAGES, {"move.running", "move.postrun"}),
        ("speed_factor=0.28", STAGES, {"move.motion"}),
    ],
)
def test_an_object_fails_the_clauses_that_it_breaks_and_no_others(
    fault: str, stages: tuple[Stage, ...], failed: set[str]
) -> None:
    assert with_verdict(report_with(fault, stages=stages), Outcome.FAIL) == failed


@pytest.mark.parametrize(
    ("fault", "verdict", "words"),
    [
        # So fast, as it says, that the probe ends at once.
        ("speed_factor=3.6", Outcome.NOT_RUN, r"drives \d\.\d m/s and states \d\.\d m/s"),
        ("speed_factor=0.28", Outcome.FAIL, r"\d\.\d+ m/s stated, way of \d\.\d+ m/s"),
    ],
)
def test_an_object_that_states_another_speed_is_told_both_and_is_not_armed(
    fault: str, verdict: Outcome, words: str
) -> None:
    report = report_with(fault)
    row = report.row("move.motion")
    assert row is not None
    assert row.verdict is verdict
    assert re.search(words, row.text)
    assert "(move.motion)" in " ".join(cannot_arm(report, LIMITS, report.firmware, None))


@pytest.mark.parametrize("fault", ["driving_state=77", "driving_state=3"])
def test_an_object_that_states_another_state_while_it_drives_is_not_armed(fault: str) -> None:
    report = report_with(fault)
    text = " ".join(cannot_arm(report, LIMITS, report.firmware, None))
    assert "move.running" in text
    assert ("listen.values" in text) is fault.endswith("77")


@pytest.mark.parametrize(
    ("step", "settled", "stated", "clause"),
    [
        ("listen", C.DISARMED, C.RUNNING, "connect.disarmed"),
        ("listen", C.DISARMED, C.ABORTING, "connect.disarmed"),
        ("arm", C.ARMED, C.DISARMED, "arm.arm"),
        ("arm", C.ARMED, C.RUNNING, "arm.arm"),
        ("arm_loss", C.ARMED, C.RUNNING, "arm.heartbeat_loss"),
        ("arm_again", C.DISARMED, C.ARMED, "arm.reconnect"),
        ("abort", C.ARMED, C.RUNNING, "move.running"),
        ("normal_stop", C.DISARMED, C.RUNNING, "move.postrun"),
    ],
)
def test_a_state_that_is_left_again_is_judged_by_each_report(
    step: str, settled: C, stated: C, clause: str
) -> None:
    """The object states another one after five reports of it."""
    seen = 0

    def reports(now: str, monr: Monr) -> Monr:
        nonlocal seen
        is_it = now == step and monr.state == settled
        seen += is_it
        return replace(monr, state=int(stated)) if seen > 5 and is_it else monr

    until = STAGES.index(Stage(clause.partition(".")[0]))
    report = Probed(reports=reports, stages=STAGES[: until + 1]).run()
    row = report.row(clause)
    assert row is not None
    assert row.verdict is Outcome.FAIL
    assert stated.name in row.text
    assert row.came


def test_reports_that_overtake_each_other_tell_nothing_of_the_state() -> None:
    """Only the message counters, which aren't asked for, show that reports came out of order."""
    report = Probed(link=ReorderingLink).run()
    assert with_verdict(report, Outcome.FAIL) == {"listen.counter"}
    assert cannot_arm(report, LIMITS, report.firmware, None) == ()


@pytest.mark.parametrize("fault", ["deaf_to_abort@0", "deaf_to_silence"])
def test_an_object_that_drives_on_may_not_be_armed(fault: str) -> None:
    report = report_with(fault)
    clause = "move.abort" if fault == "deaf_to_abort@0" else "move.heartbeat_loss"
    assert clause in " ".join(cannot_arm(report, LIMITS, report.firmware, None))


def test_what_it_reports_while_it_drives_on_is_not_believed() -> None:
    row = report_with("deaf_to_abort@0").row("move.abort")
    assert row is not None
    # Its trajectory's end stopped it, and nothing else.
    assert row.measured is not None
    assert row.measured > 2.0
    assert "its trajectory slows" in row.text


def test_an_object_that_forgets_an_abort_while_it_stands_is_not_moved() -> None:
    probed = Probed("deaf_to_abort")
    report = probed.run()
    assert with_verdict(report, Outcome.FAIL) == {"arm.latch", "arm.all_clear"}
    assert "it isn't moved: arm.all_clear failed while it stood" in probed.told
    assert probed.object.body.x_m == 0.0


def test_another_version_is_named_and_nothing_more_is_asked() -> None:
    report = report_with("wrong_version", stages=CONNECT)
    row = report.row("listen.frames")
    assert row is not None
    assert "version 3, only 2 is known" in row.text
    assert row.came
    assert "listen.report" in with_verdict(report, Outcome.FAIL)
    assert with_verdict(report, Outcome.NOT_RUN) >= {"connect.identity", "move.abort"}
    assert with_verdict(report, Outcome.PASS) <= {"listen.tcp"}


def test_a_yaw_that_is_none_keeps_it_from_being_moved() -> None:
    report = report_with("yaw_range", stages=CONNECT)
    assert {"listen.fields", "listen.values"} <= with_verdict(report, Outcome.FAIL)


def test_messages_that_were_not_answered_are_named() -> None:
    probed = Probed(stages=CONNECT, lost=lambda message: isinstance(message, Grem))
    row = probed.run().row("connect.acknowledge")
    assert row is not None
    assert (row.verdict, row.measured) == (Outcome.FAIL, 2.0)
    assert row.text == "no answer to OSEM, no answer to TRAJ"
    assert row.sent[0].startswith("7f7e")


# -- limits of the probe itself -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("at", "error"),
    [("arms", KeyboardInterrupt), ("moves it, and then: ABORT", RuntimeError)],
)
def test_whatever_ends_a_probe_it_leaves_with_a_second_of_abort(
    at: str, error: type[BaseException]
) -> None:
    def watch(text: str) -> None:
        # In the middle of a step: the next thing that is told belongs to another one.
        if text == at:
            probed.probe._armed = True
            raise error

    probed = Probed(watch=watch)
    with pytest.raises(error):
        probed.run()
    ended_ns = probed.clock.at_ns
    last = [status for at_ns, status in probed.beats if at_ns > ended_ns - S]
    assert set(last) == {CentreStatus.ABORT}
    assert len(last) >= 95
    assert probed.object.body.speed_mps == 0.0
    assert with_verdict(probed.report(), Outcome.NOT_RUN)


def test_an_object_that_was_never_armed_is_left_without_an_abort() -> None:
    probed = Probed(stages=CONNECT)
    probed.run()
    assert {status for _, status in probed.beats} == {CentreStatus.INIT}


def test_an_object_whose_way_does_not_fit_the_fence_is_not_moved() -> None:
    near = ((-20.0, -20.0), (24.0, -20.0), (24.0, 20.0), (-20.0, 20.0))
    probed = Probed(way=FencedWay(near, SIZE))
    report = probed.run()
    assert "outside of the fence" in probed.told[-2]
    assert probed.object.body.x_m == 0.0
    assert with_verdict(report, Outcome.NOT_RUN) >= {"move.abort", "move.heartbeat_loss"}


def test_an_object_that_loses_its_link_while_it_moves_is_aborted() -> None:
    probed = Probed("link_cut@1")
    report = probed.run()
    assert any("no place was reported" in text for text in probed.told)
    assert "move.abort" not in with_verdict(report, Outcome.PASS)


HERE = Pose2(0.0, 0.0, 0.0)
WAY = Motion(path=[(0.0, 0.0), (60.0, 0.0)], cruise_mps=5.0)


@pytest.mark.parametrize(
    ("motion", "pose", "why"),
    [
        (None, Pose2(375.0, 0.0, 0.0), "outside of the fence"),
        (None, Pose2(0.0, 0.0, 1.57), "outside of the fence"),
        (WAY.model_copy(update={"cruise_mps": 10.5}), HERE, "faster than a probe drives"),
        (WAY, Pose2(45.0, 0.0, 0.0), "too short to hold 5 m/s for 3 s"),
        (WAY, Pose2(0.0, 0.6, 0.0), "0.6 m and 0° off its trajectory"),
        (WAY, Pose2(0.0, 0.0, 0.6), "34° off its trajectory"),
        (WAY, Pose2(60.0, 0.0, 0.0), "its trajectory's end"),
    ],
)
def test_a_way_that_must_not_be_driven_is_refused(
    motion: Motion | None, pose: Pose2, why: str
) -> None:
    found = FencedWay(FENCE, SIZE, motion).plan(pose)
    assert isinstance(found, str)
    assert why in found


def test_a_way_goes_on_where_the_object_stands() -> None:
    found = FencedWay(FENCE, SIZE, WAY).plan(Pose2(20.0, 0.4, 0.1))
    assert isinstance(found, Points)
    _, x, y, _, speed = found.columns[:5]
    assert (x[0], x[-1], abs(y).max()) == (20.0, 60.0, 0.0)
    assert [speed[0], speed.max(), speed[-1]] == pytest.approx([0.0, 5.0, 0.0])


def test_the_stop_way_beyond_the_end_must_lie_inside() -> None:
    # 60 m of way, 2.5 m of object, and 5 m/s for 1.5 s and at 2 m/s² with half a metre.
    def fence(end_m: float) -> FencedWay:
        return FencedWay(((-9.0, -9.0), (end_m, -9.0), (end_m, 9.0), (-9.0, 9.0)), SIZE, WAY)

    points = FencedWay(FENCE, SIZE, WAY).plan(HERE)
    assert isinstance(points, Points)
    assert isinstance(fence(80.0).plan(HERE), Points)
    assert "outside of the fence" in str(fence(62.9).plan(HERE))


# -- the command ----------------------------------------------------------------------------------

CORNERS = "-9,-9 90,-9 90,9 -9,9"


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--stage", "move"], "needs --may-move and --fence"),
        (["--stage", "move", "--may-move"], "needs --may-move and --fence"),
        (["--stage", "move", "--fence", CORNERS], "needs --may-move and --fence"),
        (["--stage", "move", "--may-move", "--fence", CORNERS], "needs --origin"),
        (["--fence", "1,2 3,4 5,6"], "has 3 corners"),
        (["--fence", "1,2 3,4 5,6 7"], "needs 2 numbers"),
        (["--fence", "nowhere.yaml"], "can't be read"),
        (["--origin", "57.7"], "needs 2 numbers"),
        (["--origin", "57.7,12.9,1,2"], "needs 3 numbers"),
        (["--origin", "95,12.9"], "--origin: latitude 95 must be from -90 to 90"),
        (["--origin", "57.7,-181,3"], "--origin: longitude -181 must be from -180 to 180"),
        (["--size", "1,nan,1"], "needs 3 numbers"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_sent(options: list[str], why: str) -> None:
    result = CliRunner().invoke(iso, ["probe", "127.0.0.1:2", *options])
    assert why in f"{result.output} {result.exception}"


DATUM = {"latitude_deg": 57.7, "longitude_deg": 12.9, "yaw_rad": 0.5}
OUTLINE = [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]]


@pytest.mark.parametrize("geofence", [OUTLINE, {"points": OUTLINE}])
def test_a_fence_is_that_of_a_run_file_or_of_a_site_file(tmp_path: Path, geofence: object) -> None:
    file = tmp_path / "place.json"
    file.write_text(json.dumps({"geofence": geofence, "datum": DATUM, "more": 1}))
    fence, datum = load_fence(str(file))
    assert fence == ((0.0, 0.0), (9.0, 0.0), (9.0, 9.0))
    assert datum is not None
    assert (datum.place.latitude_deg, datum.yaw_rad) == (57.7, 0.5)
    file.write_text(json.dumps({"geofence": geofence}))
    assert load_fence(str(file))[1] is None


def test_a_fence_file_is_a_file_whatever_its_name_and_whether_it_is_there(tmp_path: Path) -> None:
    for name in ("my own, new.yaml", "my own site", "none.json"):
        with pytest.raises(InputError, match="can't be read: No such file"):
            load_fence(str(tmp_path / name))
    with pytest.raises(InputError, match="--fence: has 3 corners"):
        load_fence("0,0 9,9 9,0")


def test_a_fence_without_an_inside_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--fence: crosses itself .* list its corners in order"):
        load_fence("0,0 9,9 9,0 0,8")
    file = tmp_path / "place.json"
    file.write_text(json.dumps({"geofence": [[0, 0], [9, 0], [9, 9], [4, 0], [0, 9]]}))
    with pytest.raises(InputError, match=r"place.json: geofence: touches itself"):
        load_fence(str(file))


def test_a_thin_wall_across_the_way_is_part_of_the_fence() -> None:
    low, high = -40.0, 40.0
    for at_m in (8.0, 12.34, 23.0):
        wall = [(at_m + 0.01, high), (at_m + 0.01, -5.0), (at_m, -5.0), (at_m, high)]
        fence = ((low, low), (60.0, low), (60.0, high), *wall, (low, high))
        found = FencedWay(fence, SIZE).plan(HERE)
        assert isinstance(found, str)
        assert "outside of the fence" in found
        assert not FencedWay(fence, SIZE).holds(Pose2(at_m - 0.5 * SIZE.front_m, 0.0, 0.0))


def test_a_fence_that_is_a_strip_of_road_names_what_to_give_instead(tmp_path: Path) -> None:
    file = tmp_path / "site.json"
    file.write_text(json.dumps({"geofence": {"block": "b1", "from_s_m": 0.0}}))
    with pytest.raises(InputError, match=r"site.json: geofence: is a strip .* run file"):
        load_fence(str(file))


def test_the_way_of_a_trajectory_file_is_driven_at_its_highest_speed(tmp_path: Path) -> None:
    file = tmp_path / "way.csv"
    rows = [f"{t},{4.0 * t},0.0,0.0,{0.0 if t == 10 else 4.0}" for t in range(11)]
    file.write_text("\n".join(["t_s,x_m,y_m,yaw_rad,speed_mps", *rows]))
    found = load_motion(file, Datum(PLACE))
    assert (found.path[0], found.path[-1]) == ((0.0, 0.0), (40.0, 0.0))
    assert found.cruise_mps == 4.0
    file.write_text("t_s,x_m,y_m,yaw_rad,speed_mps\n0,1,1,0,0\n1,1,1,0,0\n")
    with pytest.raises(InputError, match=r"way.csv: leads nowhere"):
        load_motion(file, Datum(PLACE))


@pytest.mark.parametrize("address", ["", "a:b", "127.0.0.1:1", "127.0.0.1:65536", "::1"])
def test_an_address_that_is_none_is_refused(address: str) -> None:
    result = CliRunner().invoke(iso, ["probe", address])
    assert "is no address" in str(result.exception)


def test_nobody_at_the_address_is_a_report_with_exit_status_1(tmp_path: Path) -> None:
    with ObjectSockets() as sockets:
        port = sockets.port
    path = tmp_path / "report.json"
    result = CliRunner().invoke(
        iso,
        ["probe", f"127.0.0.1:{port}", "--json", str(path), "--class", "bus", "--omnidirectional"],
        standalone_mode=False,
    )
    assert result.return_value == 1
    assert "Connection refused" in result.output
    report = load_report(path)
    assert (report.host, report.port, report.firmware) == ("127.0.0.1", port, None)
    assert (report.object_class, report.omnidirectional) == ("bus", True)
    assert with_verdict(report, Outcome.FAIL) == {"listen.tcp", "listen.report", *_UNHEARD}
    assert json.loads(path.read_text())["stages"] == ["listen", "connect"]


@pytest.mark.parametrize(
    ("host", "cause"),
    [
        ("a..b", "'a..b' is no name of a host"),
        ("nohost.invalid", "'nohost.invalid' has no address: "),
    ],
)
def test_a_host_that_cannot_be_reached_is_the_finding_of_its_first_clause(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, host: str, cause: str
) -> None:
    real = socket.getaddrinfo

    def resolve(name: str, *args: Any, **given: Any) -> Any:
        if name == "nohost.invalid":
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return real(name, *args, **given)

    monkeypatch.setattr(socket, "getaddrinfo", resolve)
    path = tmp_path / "report.json"
    result = CliRunner().invoke(iso, ["probe", host, "--json", str(path)], standalone_mode=False)
    assert (result.exception, result.return_value) == (None, 1)
    row = load_report(path).row("listen.tcp")
    assert row is not None
    assert row.verdict is Outcome.FAIL
    assert cause in row.text
    assert "codec" not in result.output


_UNHEARD = {c.id for c in CLAUSES if c.step == "listen"}


@pytest.mark.parametrize("clause", CLAUSES, ids=lambda clause: clause.id)
def test_no_clause_passes_where_nothing_was_sent_and_nothing_came(clause: ProbeClause) -> None:
    step = Step(0, problem="no connection: refused")
    found = clause.judge(step, clause, {clause.step: step})
    assert found.verdict is not Outcome.PASS
    assert found.measured is None


def test_clauses_are_named_once_and_belong_to_their_stages() -> None:
    ids = [clause.id for clause in CLAUSES]
    assert len(set(ids)) == len(ids)
    order = [list(Stage).index(clause.stage) for clause in CLAUSES]
    assert order == sorted(order)
