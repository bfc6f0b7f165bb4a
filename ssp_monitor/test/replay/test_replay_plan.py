"""The plan of a replay: topics that are published, their names, and those that are left out."""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from ssp_core import names
from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.reading.reader import BagReader, TopicInfo
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cli import main
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError
from ssp_core.world.transforms import TF_TYPE, Transform, decode_transforms, encode_transforms
from ssp_monitor.recorder.recorder import OFFERED
from ssp_monitor.recorder.topics import Profile
from ssp_monitor.replay.plan import (
    MOST_LATCHED,
    Plan,
    PublisherQos,
    ReplayOptions,
    is_command,
    make_plan,
    offer_of,
    played,
    session_signs,
)
from ssp_monitor.replay.player import Lateness, MessageSource, Player, Progress, ReadAhead
from ssp_monitor.replay.terminal import (
    ReplayOutcome,
    plan_lines,
    progress_line,
)

RECORDED = {
    "/clock": TopicInfo("rosgraph_msgs/msg/Clock", 10),
    "/ssp/manager/heartbeat": TopicInfo("ssp_msgs/msg/Heartbeat", 5),
    "/ssp/ot1/reference": TopicInfo("ssp_msgs/msg/Reference", 2),
    "/ssp/ot1/reference_ack": TopicInfo("ssp_msgs/msg/ReferenceAck", 2),
    "/ssp/vut/state": TopicInfo("ssp_msgs/msg/ObjectState", 100),
    "/ssp/world/tick": TopicInfo("ssp_msgs/msg/WorldTick", 100),
}


def _plan(**wishes: object) -> Plan:
    return make_plan(RECORDED, dataclasses.replace(ReplayOptions(), **wishes), lambda _t, _h: None)


def _names(plan: Plan) -> list[str]:
    return [line.topic for line in plan.lines]


def test_a_replay_says_that_it_plays_and_not_what_once_took_part():
    """Recorded declarations of participants would be taken for those of a living session."""
    recorded = {
        **RECORDED,
        "/ssp/declared/vut": TopicInfo("std_msgs/msg/String", 1),
        "/ssp/declared/vut/camera": TopicInfo("std_msgs/msg/String", 1),
        "/ssp/ot1/state": TopicInfo("ssp_msgs/msg/ObjectState", 100),
        "/ssp/vut/front_camera/image/compressed": TopicInfo("sensor_msgs/msg/CompressedImage", 9),
        "/note": TopicInfo("std_msgs/msg/String", 1),
    }
    plan = make_plan(recorded, ReplayOptions(), lambda _t, _h: None)
    assert not [line for line in plan.lines if "declared" in line.topic]
    told = [one for one in plan.left_out if "declared" in one.topic]
    assert [one.topic for one in told] == ["/ssp/declared/vut", "/ssp/declared/vut/camera"]
    assert all("took part" in one.why and not one.is_command for one in told)
    assert played(plan.lines) == ("ot1", "ot1/body", "vut", "vut/camera", "vut/positioning")
    # Neither by a wish nor under another name.
    for wishes in (
        ReplayOptions(topics=("/ssp/declared/vut", "/clock")),
        ReplayOptions(remap={"/note": "/ssp/declared/vut"}),
    ):
        plan = make_plan(recorded, wishes, lambda _t, _h: None)
        assert not [line for line in plan.lines if "declared" in line.topic]
    plan = make_plan(recorded, ReplayOptions(remap={"/ssp/vut/state": "/old"}), lambda _t, _h: None)
    assert "vut" not in played(plan.lines)


def test_by_default_everything_but_commands_is_published_and_the_recorded_clock():
    plan = _plan()
    assert _names(plan) == ["/clock", "/ssp/ot1/reference_ack", "/ssp/vut/state"]
    assert plan.clock_recorded
    assert plan.clock_hz == 0.0
    assert [(one.topic, one.is_command) for one in plan.left_out] == [
        ("/ssp/manager/heartbeat", True),
        ("/ssp/ot1/reference", True),
        ("/ssp/world/tick", True),
    ]
    said = "\n".join(plan_lines(plan))
    assert "/ssp/ot1/reference (2)" in said
    assert "--commands" in said
    assert "/clock as recorded" in said


def test_commands_are_published_when_they_are_asked_for():
    assert _names(_plan(commands=True)) == sorted(RECORDED)


@pytest.mark.parametrize(
    ("clock_hz", "excluded", "expected"),
    [
        (None, (), (True, 0.0)),
        (50.0, (), (False, 50.0)),
        (0.0, (), (False, 0.0)),
        (None, ("/clock",), (False, 100.0)),
    ],
)
def test_the_clock_is_the_recorded_one_or_made(clock_hz, excluded, expected):
    plan = _plan(clock_hz=clock_hz, exclude=excluded)
    assert (plan.clock_recorded, plan.clock_hz) == expected
    assert ("/clock" in _names(plan)) is expected[0]


def test_topics_are_named_or_found_by_an_expression():
    assert _names(_plan(topics=("vut/state",))) == ["/ssp/vut/state"]
    assert _names(_plan(topics=("ot1",))) == ["/ssp/ot1/reference_ack"]
    assert _names(_plan(exclude=("/ssp",))) == ["/clock"]
    with pytest.raises(InputError, match="found in no topic"):
        _plan(topics=("nobody",))
    with pytest.raises(InputError, match="no topic that is left"):
        _plan(topics=("clock",), exclude=("clock",))


def test_a_command_stays_one_under_another_name_and_a_name_can_make_one():
    plan = _plan(remap={"/ssp/ot1/reference": "/harmless"})
    assert "/harmless" not in _names(plan)
    recorded = {"/speed": TopicInfo("std_msgs/msg/Float64", 1), "/x": RECORDED["/clock"]}
    plan = make_plan(recorded, ReplayOptions(remap={"/speed": "/cmd_vel"}), lambda _t, _h: None)
    assert [one.topic for one in plan.left_out] == ["/speed"]
    # The project's own types are no excuse for a new name.
    plan = _plan(remap={"/ssp/vut/state": "/ssp/ot1/reference"})
    assert "/ssp/vut/state" in [one.topic for one in plan.left_out if one.is_command]


def test_remaps_are_checked():
    assert "/ssp/v/state" in _names(_plan(remap={"vut/state": "v/state"}))
    with pytest.raises(InputError, match="is no topic of the bag"):
        _plan(remap={"/nobody": "/x"})
    with pytest.raises(InputError, match="is no topic name"):
        _plan(remap={"/clock": "/../x"})
    with pytest.raises(InputError, match="two types"):
        _plan(remap={"/ssp/vut/state": "/x", "/ssp/ot1/reference_ack": "/x"})


def test_what_cannot_be_published_is_left_out_with_the_reason():
    recorded = RECORDED | {"/bad name": TopicInfo("std_msgs/msg/String", 1)}

    def missing(msgtype: str, _: str) -> str | None:
        return "its type is not installed" if msgtype.endswith("ObjectState") else None

    plan = make_plan(recorded, ReplayOptions(), missing)
    why = {one.topic: one.why for one in plan.left_out if not one.is_command}
    assert why["/ssp/vut/state"] == "its type is not installed"
    assert "no name of a ROS topic" in why["/bad name"]
    with pytest.raises(InputError, match="--commands publishes") as caught:
        _plan(topics=("reference$",))
    assert "may move objects" in str(caught.value)


@pytest.mark.parametrize(
    ("topic", "msgtype", "expected"),
    [
        ("/ssp/ot1/reference", "ssp_msgs/msg/Reference", True),
        ("/ssp/ot1/reference_ack", "ssp_msgs/msg/ReferenceAck", False),
        ("/ssp/world/actuator_commands", "ssp_msgs/msg/ActuatorCommands", True),
        ("/ssp/vut/command", "ssp_msgs/msg/ActuatorCommand", True),
        ("/ssp/world/step_done", "ssp_msgs/msg/StepDone", True),
        ("/ssp/vut/state", "ssp_msgs/msg/ObjectState", False),
        ("/cmd_vel", "geometry_msgs/msg/Twist", True),
        ("/car/steering_cmd", "std_msgs/msg/Float64", True),
        ("/goal_pose", "geometry_msgs/msg/PoseStamped", True),
        ("/control/trajectory", "autoware_control_msgs/msg/Control", True),
        ("/drive", "ackermann_msgs/msg/AckermannDriveStamped", True),
        ("/camera/image", "sensor_msgs/msg/Image", False),
        ("/commander/status", "std_msgs/msg/String", False),
        ("/best_open/latest_opinion", "std_msgs/msg/String", False),
        ("/vehicle/velocity_status", "autoware_vehicle_msgs/msg/VelocityReport", True),
        ("/planning/lane", "autoware_planning_msgs/msg/LaneletRoute", True),
        ("/car/throttle/value", "std_msgs/msg/Float64", True),
        ("/car/brakeLevel", "std_msgs/msg/Float64", True),
        ("/car/frontSteering", "std_msgs/msg/Float64", True),
        ("/cmd/linear", "std_msgs/msg/Float64", True),
        ("/cmdVel", "std_msgs/msg/Float64", True),
        ("/cmdvel", "std_msgs/msg/Float64", True),
        ("/target2/speed", "std_msgs/msg/Float64", True),
        ("/e_stop", "std_msgs/msg/Bool", True),
        ("/emergency/state", "std_msgs/msg/Bool", True),
        ("/gear", "std_msgs/msg/Int8", True),
        ("/engage", "std_msgs/msg/Bool", True),
        ("/arm", "trajectory_msgs/msg/JointTrajectory", True),
        ("/a", "geometry_msgs/msg/Twist", True),
        ("/a", "geometry_msgs/msg/TwistStamped", True),
        ("/a", "ackermann_msgs/msg/AckermannDrive", True),
        ("/a", "some_maker_msgs/msg/SteeringReport", True),
        ("/a", "raptor_dbw_msgs/msg/Report", True),
        ("/a", "dbw_mkz_msgs/msg/Report", True),
        ("/a", "can_msgs/msg/Frame", True),
        ("/odometry/twist", "std_msgs/msg/Float64", True),  # rather too much than too little
        ("/odometry", "nav_msgs/msg/Odometry", False),
        ("/tf", "tf2_msgs/msg/TFMessage", False),
        ("/imu", "sensor_msgs/msg/Imu", False),
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", False),
        ("/ssp/markers/objects", "visualization_msgs/msg/MarkerArray", False),
        ("/rosout", "rcl_interfaces/msg/Log", False),
    ],
)
def test_commands_are_known_by_type_and_by_name(topic, msgtype, expected):
    assert is_command(topic, msgtype) is expected


def test_a_session_shows_by_its_nodes_and_by_its_services():
    nodes = [("listener", "/"), ("object_target", "/ssp"), ("monitor", "/ssp")]
    assert session_signs(nodes, []) == ["node /ssp/object_target"]
    services = [("/a/b", ["std_srvs/srv/Trigger"]), ("/x/command", ["ssp_msgs/srv/ObjectCommand"])]
    assert session_signs([("renamed", "/")], services) == ["service /x/command"]
    assert session_signs([("replay", "/ssp")], [("/a", ["std_srvs/srv/Trigger"])]) == []


def test_offers_are_those_of_the_bag():
    assert offer_of("/x", OFFERED[Profile.LATCHED]) == PublisherQos(True, True, 20)
    assert offer_of("/x", OFFERED[Profile.STATE]) == PublisherQos(True, False)
    assert offer_of(names.TF_STATIC, "").latched
    numbers = "[{history: 1, depth: 7, reliability: 2, durability: 1}]"  # as rosbag2 once wrote
    assert offer_of("/x", numbers) == PublisherQos(False, True, 7)


def test_of_several_publishers_the_strongest_offer_is_taken():
    weak = "- {reliability: best_effort, durability: volatile, depth: 5}\n"
    strong = "- {reliability: reliable, durability: transient_local, depth: 3}\n"
    assert offer_of("/x", weak + strong) == PublisherQos(True, True, 8)
    assert offer_of("/x", weak) == PublisherQos(reliable=False)


@pytest.mark.parametrize("depth", ["many", "-1", "true", "1e9", "100000000"])
def test_a_depth_out_of_a_bag_never_takes_all_memory(depth):
    offer = offer_of("/x", f"[{{durability: transient_local, depth: {depth}}}]")
    assert 1 <= offer.depth <= MOST_LATCHED


def test_without_a_word_in_the_bag_the_name_decides():
    assert offer_of("/ssp/session_state", "") == PublisherQos(True, True, 20)
    assert offer_of("/ssp/vut/state", "") == PublisherQos()
    assert offer_of("/ssp/vut/state", "{no list}") == PublisherQos()


@pytest.fixture
def bag(tmp_path):
    """Five latched and fifty other messages in five seconds."""
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.add_topic("/kept", "std_msgs/msg/Int32", offered_qos(2, transient_local=True))
        writer.add_topic("/others", "std_msgs/msg/Int32", offered_qos(50))
        for k in range(50):
            ns = 7 * NS_PER_S + k * NS_PER_S // 10
            if k % 10 == 0:
                writer.write("/kept", b"kept%02d" % k, ns, ns)
            writer.write("/others", b"other%02d" % k, ns, ns)
    return path


@pytest.mark.parametrize(
    "qos",
    [
        "",
        offered_qos(1, transient_local=True),
        "- {durability: transient_local, history: 3, depth: 0}",
    ],
)
def test_each_message_of_static_transforms_has_those_of_all_publishers(tmp_path, qos):
    """A subscriber that joins late gets one message, whichever the last publisher's was."""
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/tf_static", TF_TYPE, qos)
        writer.add_topic("/text", "std_msgs/msg/String")
        for k, child in enumerate(("mast", "camera", "lidar")):
            one = Transform("base_link", child, 0, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
            writer.write("/tf_static", encode_transforms([one]), k, k)
        for k in range(4):
            writer.write("/text", b"", k * 10**9, k * 10**9)

    def children(messages):
        found = [m for m in messages if m.topic == "/tf_static"]
        return [[one.child for one in decode_transforms(m.data)] for m in found]

    with BagReader(tmp_path / "bag") as reader:
        plan = make_plan(reader.topics, ReplayOptions(), lambda *_: None)
        (line,) = [line for line in plan.lines if line.recorded == "/tf_static"]
        assert line.offer == PublisherQos(reliable=True, latched=True, depth=1)
        whole = MessageSource(reader, plan.lines, ReplayOptions())
        for _ in range(2):  # in each lap
            assert whole.latched_messages() == []
            sent = children(whole.messages())
            assert sent == [["mast"], ["mast", "camera"], ["mast", "camera", "lidar"]]
        later = MessageSource(reader, plan.lines, ReplayOptions(start_s=1.0))
        assert children(later.latched_messages()) == [["mast", "camera", "lidar"]]
        assert children(later.messages()) == []


def test_a_tape_has_the_stretch_and_what_was_kept_before_it(bag):
    with BagReader(bag) as reader:
        plan = make_plan(reader.topics, ReplayOptions(), lambda _t, _h: None)
        tape = MessageSource(reader, plan.lines, ReplayOptions(start_s=2.5, end_s=4.0))
        assert [m.data for m in tape.latched_messages()] == [b"kept10", b"kept20"]
        messages = tape.messages()
        stretch = list(messages)
        messages.close()
        assert stretch[0].data == b"other25"
        assert [m.data for m in stretch[-2:]] == [b"kept40", b"other40"]
        assert MessageSource(reader, plan.lines, ReplayOptions()).latched_messages() == []
        with pytest.raises(InputError, match=r"bag is 4\.900 s long"):
            MessageSource(reader, plan.lines, ReplayOptions(start_s=5.0))
        with pytest.raises(InputError, match="--end is 1"):
            MessageSource(reader, plan.lines, ReplayOptions(start_s=2.0, end_s=1.0))


def test_reading_ahead_keeps_order_and_a_bounded_heap():
    taken = 0

    def source() -> Iterator[BagMessage]:
        nonlocal taken
        for k in range(1000):
            taken += 1
            yield BagMessage("/a", k, k, bytes(100))

    ahead = ReadAhead(source(), limit_bytes=1000)
    for k in range(1000):
        assert next(ahead).log_time_ns == k
        # Ten fit, and the reader holds one more in its hand.
        assert taken <= k + 12
    with pytest.raises(StopIteration):
        next(ahead)
    ahead.close()


def test_damage_is_raised_where_it_stands_and_closing_early_ends_the_reader():
    def source() -> Iterator[BagMessage]:
        yield BagMessage("/a", 0, 0, b"")
        raise InputError("is damaged", file="x.mcap")

    ahead = ReadAhead(source())
    assert next(ahead).log_time_ns == 0
    with pytest.raises(InputError, match="is damaged"):
        next(ahead)
    ahead.close()
    endless = ReadAhead((BagMessage("/a", k, k, bytes(9)) for k in range(10**9)), limit_bytes=90)
    next(endless)
    endless.close()


def _player(
    reader: BagReader,
    send: Callable[[BagMessage], None],
    over: threading.Event,
    tick: Callable[[int], None] = lambda _: None,
    **wishes: Any,
) -> Player:
    options = ReplayOptions(**{"clock_hz": 0.0, **wishes})
    plan = make_plan(reader.topics, options, lambda _t, _h: None)
    tape = MessageSource(reader, plan.lines, options)
    return Player(tape, plan, options, send, tick, over.set)


def test_a_player_loops_until_it_is_stopped_and_keeps_the_order(bag):
    sent: list[bytes] = []
    enough, over = threading.Event(), threading.Event()

    def send(message: BagMessage) -> None:
        sent.append(message.data)
        if len(sent) >= 125:
            enough.set()

    with BagReader(bag) as reader:
        player = _player(reader, send, over, start_s=1.0, rate=1000.0, loop=True)
        player.start()
        assert enough.wait(600.0)
        player.stop()
    assert over.is_set()
    assert player.error is None
    # Each lap: what was kept before the start, then the stretch from 1.0 s on.
    lap = sent[:45]
    assert lap[:3] == [b"kept00", b"kept10", b"other10"]
    assert lap[-1] == b"other49"
    assert sent[45:90] == lap
    assert player.progress().lap >= 3


def test_a_paused_player_takes_steps_and_a_new_rate_and_ends_at_the_end(bag):
    sent: list[bytes] = []
    ticks: list[int] = []
    over, first = threading.Event(), threading.Event()

    def tick(bag_ns: int) -> None:
        ticks.append(bag_ns)
        first.set()

    with BagReader(bag) as reader:
        player = _player(
            reader,
            lambda m: sent.append(m.data),
            over,
            tick,
            rate=0.01,
            paused=True,
            clock_hz=200.0,
        )
        player.start()
        assert first.wait(600.0)
        assert sent == []
        player.set_rate(1000.0)
        with pytest.raises(ValueError, match="rate must be from"):
            player.set_rate(0.0)
        assert player.progress().rate == 1000.0
        assert not over.is_set()
        player.resume()
        assert over.wait(600.0)
        player.stop()
    assert len(sent) == 55
    assert ticks == sorted(ticks)
    assert player.lateness.count == 55


def test_what_goes_wrong_in_publishing_ends_the_player_and_is_told(bag):
    over = threading.Event()

    def send(_: BagMessage) -> None:
        raise InputError("can't be sent")

    with BagReader(bag) as reader:
        player = _player(reader, send, over)
        player.start()
        assert over.wait(600.0)
        player.stop()
    assert isinstance(player.error, InputError)


def test_the_line_and_the_outcome_say_where_it_is_and_how_late():
    progress = Progress(int(12.5e9), 2.0, False, 300_000_000, 42, 3)
    line = progress_line(progress, 10 * NS_PER_S, 20 * NS_PER_S, 5)
    assert line.split(" · ") == [
        "    2.500 of 10.000 s",
        "x2",
        "5 topics",
        "42 messages",
        "lap 3",
        "0.3 s behind schedule",
    ]
    paused = dataclasses.replace(progress, paused=True, behind_ns=0)
    assert "paused" in progress_line(paused, 0, 1, 1)
    late = Lateness()
    for _ in range(10):
        late.add(200_000_000)
    outcome = ReplayOutcome("end", progress, late, _plan())
    assert math.isclose(outcome.as_json()["late_s"]["max"], 0.2)
    assert "did not keep up" in "\n".join(outcome.lines())


def test_of_a_sessions_own_topics_only_commands_are_left_out():
    reports = (
        *(names.SESSION_STATE, names.TRIGGER_EVENT, names.PHASE_EVENT, names.SAFETY_EVENT),
        *(names.FAULT_EVENT, names.RECORDER_STATUS, names.LINK_STATUS, names.HEARTBEAT_REPLY),
        *(names.OBJECT_STATES, names.state_topic("vut"), names.ack_topic("target1")),
    )
    for topic in reports:
        kind = topic.rsplit("/", 1)[-1].title().replace("_", "")
        assert not is_command(names.absolute(topic), f"ssp_msgs/msg/{kind}"), topic
    for topic, msgtype in (
        (names.CAMERA_IMAGE, "sensor_msgs/msg/CompressedImage"),
        (names.CAMERA_INFO, "sensor_msgs/msg/CameraInfo"),
        (names.CAMERA_MOUNT, "geometry_msgs/msg/TransformStamped"),
        (names.CLOCK, "rosgraph_msgs/msg/Clock"),
        (names.TF_STATIC, TF_TYPE),
    ):
        assert not is_command(names.absolute(topic), msgtype), topic


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        *(
            ([option, value], f"'{value}' is no number")
            for option in ("--rate", "--start", "--end", "--clock")
            for value in ("nan", "inf", "-inf")
        ),
        (["--start", "abc"], "'abc' is no number from 0"),
        (["--remap", "x"], "'x' is not FROM:=TO"),
        (["--remap", "/a:=/../b"], "'/../b' is no topic name"),
        (["--topics", "("], "--topics: is no regular expression"),
        (["--exclude", "("], "--exclude: is no regular expression"),
    ],
)
def test_values_without_sense_are_wrong_usage(options, problem, tmp_path, capsys):
    assert main(["replay", str(tmp_path / "none"), *options]) == 2
    assert problem in capsys.readouterr().err
