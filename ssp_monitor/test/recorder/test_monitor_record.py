"""``ssp bag record``: any topics, without a session."""

from __future__ import annotations

import array
import json
import os
import signal
import subprocess
import sys
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import String

from ssp_core.bag.metadata import parse_offered_qos
from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.seal import REPORT_NAME
from ssp_core.cli import main
from tests.support.bags.recorder_said import line_with, without_a_busy_disk
from tests.support.processes.children import end
from tests.support.processes.waiting import DEADLINE_S, until


@pytest.fixture
def talker(domain):
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("talker", context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


def start(*arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "ssp_core.cli", "bag", "record", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=dict(os.environ),
    )


@pytest.fixture
def recorder(talker):
    started: list[subprocess.Popen[str]] = []

    def run(*arguments: object) -> subprocess.Popen[str]:
        started.append(start(*arguments))
        return started[-1]

    yield run
    for process in started:
        end(process)


def await_reader(node: Node, publisher: Any, readers: int = 1) -> None:
    """Await a reader of a publisher's.

    The recorder makes a reader when it knows a publisher of the topic, and matches it with all
    publishers that it knows before it announces it. Those of one node become known in their order.
    """
    until(
        lambda: publisher.get_subscription_count() >= readers,
        f"subscription to {publisher.topic_name}",
    )


def qos(reliability: ReliabilityPolicy, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=50, reliability=reliability, durability=durability
    )


RELIABLE, BEST = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
VOLATILE, LATCHED = DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL


def ended(process: subprocess.Popen[str]) -> tuple[dict[str, Any], str]:
    process.send_signal(signal.SIGINT)
    shown, told = process.communicate(timeout=DEADLINE_S)
    assert "Traceback" not in told
    return json.loads(shown), told


@pytest.mark.ros
def test_topics_are_found_late_and_heard_as_their_publishers_offer_them(talker, recorder, tmp_path):
    early = talker.create_publisher(String, "/lab/early", qos(RELIABLE, LATCHED))
    early.publish(String(data="before anybody listened"))
    # One of the two is best effort: only a best-effort reader hears both.
    mixed = [
        talker.create_publisher(String, "/lab/mixed", qos(reliability, VOLATILE))
        for reliability in (RELIABLE, BEST)
    ]
    talker.create_publisher(String, "/lab/excluded", 10)
    talker.create_publisher(String, "/lab/_hidden", 10)
    process = recorder(
        "--all", "--exclude", "excluded$", "-o", tmp_path / "bag", "--json", "--reserve-mb", 0
    )
    for publisher in (early, *mixed):
        await_reader(talker, publisher)
    # Its reader shows that the recorder knows the second publisher of ``mixed`` too.
    late = talker.create_publisher(String, "/lab/late", qos(BEST, VOLATILE))
    await_reader(talker, late)
    for k in range(20):
        for publisher in (*mixed, late, early):
            publisher.publish(String(data=f"{k}"))
    # One thread of the recorder's receives all that this node sends, in order: with what is
    # acknowledged, what was sent before it as best effort has arrived.
    assert early.wait_for_all_acked(Duration(seconds=DEADLINE_S))
    result, _ = ended(process)
    assert (process.returncode, result["ok"], result["lost"]) == (0, True, 0)
    assert check_bag(tmp_path / "bag").problems == ()
    with BagReader(tmp_path / "bag") as bag:
        counts = {name: info.count for name, info in bag.topics.items()}
        assert counts == {"/lab/early": 21, "/lab/mixed": 40, "/lab/late": 20}
        first = next(iter(bag.messages(["/lab/early"])))
        assert bag.decode(first).data == "before anybody listened"
        offered = {
            name: [(p["reliability"], p["durability"]) for p in parse_offered_qos(info.offered_qos)]
            for name, info in bag.topics.items()
        }
        report = json.loads(bag.attachment(REPORT_NAME) or b"")
    assert offered == {
        "/lab/early": [("reliable", "transient_local")],
        "/lab/mixed": [("reliable", "volatile"), ("best_effort", "volatile")],
        "/lab/late": [("best_effort", "volatile")],
    }
    assert (report["received"], report["written"], report["dropped"]) == (81, 81, 0)
    assert {t["name"]: t["received"] for t in report["topics"]} == counts


@pytest.mark.ros
def test_named_topics_are_recorded_for_a_time(talker, recorder, tmp_path):
    hidden = talker.create_publisher(String, "/lab/_hidden", 10)
    talker.create_publisher(String, "/lab/other", 10)
    process = recorder(
        "/lab/_hidden", "lab/absent", "-o", tmp_path / "bag", "--duration", 20, "--reserve-mb", 0
    )
    await_reader(talker, hidden)
    hidden.publish(String(data="x"))
    shown, told = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0
    assert "1 messages of 1 topics, 0.0 MB, 0 lost, counts and checksums checked" in shown
    assert "warning: /lab/absent had no publisher" in told
    with BagReader(tmp_path / "bag") as bag:
        assert {name: info.count for name, info in bag.topics.items()} == {"/lab/_hidden": 1}


@pytest.mark.ros
def test_a_second_type_on_a_topic_is_lost_and_said(talker, recorder, tmp_path):
    first = talker.create_publisher(String, "/lab/thing", 10)
    process = recorder("--include", "^/lab", "-o", tmp_path / "bag", "--json", "--reserve-mb", 0)
    await_reader(talker, first)
    first.publish(String(data="x"))
    context = Context()
    rclpy.init(context=context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("other", context=context)
    node.create_publisher(CompressedImage, "/lab/thing", 10)
    told = line_with(process, "is also of type")
    result, _ = ended(process)
    node.destroy_node()
    rclpy.shutdown(context=context)
    assert process.returncode == 1
    assert (result["messages"], result["lost"]) == (1, 1)
    warning = (
        "/lab/thing is also of type sensor_msgs/msg/CompressedImage now: only std_msgs/msg/String "
        "is recorded, the rest is lost"
    )
    assert without_a_busy_disk(result["warnings"]) == [warning]
    assert warning in told


@pytest.mark.ros
def test_a_named_topic_of_two_types_is_a_problem(talker, recorder, tmp_path):
    context = Context()
    rclpy.init(context=context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("other", context=context)
    node.create_publisher(CompressedImage, "/lab/both", 10)
    # Of one participant's endpoints the second is known last: both types are there once it is.
    talker.create_publisher(String, "/lab/both", 10)
    until(lambda: talker.count_publishers("/lab/both") >= 2, "publishers that know each other")
    process = recorder("/lab/both", "-o", tmp_path / "bag", "--json", "--reserve-mb", 0)
    told = line_with(process, "has several types", "is also of type")
    result, rest = ended(process)
    node.destroy_node()
    rclpy.shutdown(context=context)
    assert process.returncode == 1
    if "has several types" in told:  # else one of them was found first
        assert result["problems"] == ["/lab/both has several types and is not recorded"]
        assert "had no publisher" not in told + rest
    else:
        assert result["lost"] == 1


@pytest.mark.ros
def test_a_late_publisher_that_offers_less_is_said(talker, recorder, tmp_path):
    first = talker.create_publisher(String, "/lab/thing", qos(RELIABLE, VOLATILE))
    process = recorder("--include", "^/lab", "-o", tmp_path / "bag", "--json", "--reserve-mb", 0)
    await_reader(talker, first)
    talker.create_publisher(String, "/lab/thing", qos(BEST, VOLATILE))
    line_with(process, "/lab/thing is not heard from talker: it came later")
    result, _ = ended(process)
    assert (process.returncode, result["lost"]) == (1, 1)


@pytest.mark.ros
def test_images_become_video_and_what_is_no_image_stays(talker, recorder, tmp_path):
    import cv2
    import numpy as np

    camera = talker.create_publisher(CompressedImage, "/lab/camera", qos(RELIABLE, VOLATILE))
    process = recorder(
        "--all",
        "--video",
        "h264",
        "-o",
        tmp_path / "bag",
        "--json",
        "--split-mb",
        0.1,
        "--reserve-mb",
        0,
    )
    await_reader(talker, camera)
    noise = np.random.default_rng(1)
    for _ in range(10):
        picture = noise.integers(0, 255, (240, 320, 3), dtype=np.uint8)
        jpeg = cv2.imencode(".jpg", picture)[1].tobytes()
        camera.publish(CompressedImage(format="jpeg", data=array.array("B", jpeg)))
    camera.publish(CompressedImage(format="jpeg", data=array.array("B", b"no picture")))
    assert camera.wait_for_all_acked(Duration(seconds=DEADLINE_S))
    result, _ = ended(process)
    assert (process.returncode, result["messages"]) == (0, 11)
    assert result["files"] > 1
    (warning,) = without_a_busy_disk(result["warnings"])
    assert "1 pictures could not be encoded" in warning
    with BagReader(tmp_path / "bag") as bag:
        assert {name: (info.msgtype, info.count) for name, info in bag.topics.items()} == {
            "/lab/camera": ("foxglove_msgs/msg/CompressedVideo", 10),
            "/lab/camera/original": ("sensor_msgs/msg/CompressedImage", 1),
        }


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["-o", "x"], 2, "name topics, or give --all or --include"),
        (["--include", "(", "-o", "x"], 2, "--include: is no regular expression"),
        (["--all", "--exclude", "[a", "-o", "x"], 2, "--exclude: is no regular expression"),
        (["--all", "-o", "x", "--split-mb", "0.0001"], 2, "is too small a file"),
        (["--all", "-o", "x", "--split-s", "nan"], 2, "'nan' is no number from 0"),
        (["--all", "-o", "x", "--split-mb", "inf"], 2, "'inf' is no number from 0"),
        (["--all", "-o", "x", "--duration", "inf"], 2, "'inf' is no number from 0.1"),
    ],
)
def test_wrong_arguments_are_one_message(arguments, status, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["bag", "record", *arguments]) == status
    assert message in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
