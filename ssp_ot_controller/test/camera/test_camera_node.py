"""The front_camera node as a process, on ticks of a world that this test plays."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo, CompressedImage

from ssp_core import names, ros
from ssp_core.run_file.model import Camera, RunSpec
from ssp_msgs.msg import StepDone, WorldTick
from tests.support.bags.rclpy_messages import state_to_msg
from tests.support.processes.children import end
from tests.support.processes.waiting import DEADLINE_S
from tests.support.runs import small_run
from tests.support.states import object_state

pytestmark = pytest.mark.ros
START_DEADLINE_S = DEADLINE_S  # the first start on a machine compiles the kernels
STEP_NS = 20_000_000
EVERY = 5  # 10 Hz at 20 ms a step


def run_spec(camera: Camera | None) -> RunSpec:
    return RunSpec.model_validate(small_run(run_id="camera_test", seed=5, camera=camera))


class World:
    """Publishes ticks and keeps what the camera says."""

    def __init__(self, others: Any) -> None:
        self.node, self.spin, self.spin_until = others.node, others.spin, others.spin_until
        self.images: list[CompressedImage] = []
        self.infos: list[CameraInfo] = []
        self.mounts: list[TransformStamped] = []
        self.events: list[tuple[str, int]] = []  # images and answers in the order they came
        subscribe = self.node.create_subscription
        subscribe(CompressedImage, names.CAMERA_IMAGE, self._on_image, ros.SENSOR)
        subscribe(CameraInfo, names.CAMERA_INFO, self.infos.append, ros.LATCHED)
        subscribe(TransformStamped, names.CAMERA_MOUNT, self.mounts.append, ros.LATCHED)
        subscribe(StepDone, names.STEP_DONE, self._on_done, ros.STATE)
        self.ticks = self.node.create_publisher(WorldTick, names.WORLD_TICK, ros.STATE)

    def _on_image(self, message: CompressedImage) -> None:
        self.images.append(message)
        self.events.append(("image", ros.ns_from_stamp(message.header.stamp) // STEP_NS))

    def _on_done(self, message: StepDone) -> None:
        assert message.participant == names.FRONT_CAMERA
        self.events.append(("done", message.step))

    def steps(self, kind: str) -> list[int]:
        return [step for what, step in self.events if what == kind]

    def tick(self, step: int, running: bool = True, lockstep: bool = True) -> None:
        x = 5.0 + 0.2 * step
        objects = [
            object_state(name, x_m=at, speed_mps=10.0, stamp_ns=step * STEP_NS)
            for name, at in (("ot1", x + 15.0), ("vut", x))
        ]
        message = WorldTick(
            step=step,
            running=running,
            lockstep=lockstep,
            objects=[state_to_msg(o) for o in objects],
        )
        message.header.stamp = ros.stamp_from_ns(step * STEP_NS)
        self.ticks.publish(message)


def start(run_file: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "ssp_ot_controller.ros.front_camera", "--ros-args"]
    command += ["-p", f"run_file:={run_file}"]
    return subprocess.Popen(
        command, env=os.environ.copy(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def write_run(path: Path, camera: Camera | None) -> Path:
    path.write_text(run_spec(camera).model_dump_json(by_alias=True))
    return path


@pytest.fixture
def world(others: Any) -> World:
    return World(others)


@pytest.fixture
def camera_node(world: World, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """The node, seen by the world; small pictures keep it quick."""
    process = start(write_run(tmp_path / "run.json", Camera(width_px=320, height_px=180)))

    def connected() -> bool:
        assert process.poll() is None, process.communicate()[0]
        return bool(world.mounts) and world.ticks.get_subscription_count() == 1

    try:
        world.spin_until(connected, "front_camera", START_DEADLINE_S)
        yield process
    finally:
        end(process)


def test_a_lockstep_run(world: World, camera_node: subprocess.Popen[str]) -> None:
    # While the world holds, the picture of step 0 comes again after a second.
    def hold_until(answers: int) -> float:
        deadline = time.monotonic() + DEADLINE_S
        while len(world.steps("done")) < answers:
            assert time.monotonic() < deadline, "no picture of step 0 in time"
            world.tick(0, running=False)
            world.spin(0.1)
        return time.monotonic()

    first = hold_until(1)
    assert hold_until(2) - first > 0.7
    # Faster than it can draw: all frame steps come, in order, each answered after its picture.
    steps = range(1, 8 * EVERY + 1)
    for step in steps:
        world.tick(step)
    expected = [0, 0] + [s for s in steps if s % EVERY == 0]
    world.spin_until(lambda: len(world.steps("done")) == len(expected), "answers")
    world.spin_until(lambda: len(world.images) == len(expected), "pictures")
    assert world.steps("done") == expected
    assert world.steps("image") == expected
    world.spin_until(lambda: len(world.infos) == len(expected), "camera infos")

    image = world.images[-1]
    picture = cv2.imdecode(np.asarray(image.data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (180, 320, 3)
    assert picture.std() > 20
    assert (image.format, image.header.frame_id) == ("jpeg", "vut/front_camera_optical")
    info = world.infos[-1]
    assert (info.width, info.height, info.header.stamp) == (320, 180, image.header.stamp)
    assert info.k[2] == 159.5
    assert len(world.mounts) == 1
    mount = world.mounts[0]
    assert mount.header.frame_id == "vut/base_link"
    assert mount.child_frame_id == "vut/front_camera_optical"
    assert mount.transform.translation.z == 1.45

    camera_node.send_signal(signal.SIGTERM)
    assert camera_node.wait(DEADLINE_S) == 0


def test_a_frame_whose_tick_came_before_the_end_is_drawn(
    world: World, camera_node: subprocess.Popen[str]
) -> None:
    """A session ends right after its last step, of which a busy camera may not have heard yet."""
    world.tick(EVERY)
    world.spin_until(lambda: world.steps("done") == [EVERY], "an answer")
    camera_node.send_signal(signal.SIGSTOP)
    for step in range(EVERY + 1, 3 * EVERY + 1):
        world.tick(step)
    camera_node.send_signal(signal.SIGTERM)
    camera_node.send_signal(signal.SIGCONT)
    world.spin_until(lambda: world.steps("done") == [EVERY, 2 * EVERY, 3 * EVERY], "all answers")
    world.spin_until(lambda: world.steps("image") == [EVERY, 2 * EVERY, 3 * EVERY], "pictures")
    assert camera_node.wait(DEADLINE_S) == 0


def test_realtime_drops_what_it_cannot_draw_and_says_so(
    world: World, camera_node: subprocess.Popen[str]
) -> None:
    sent = 200
    for k in range(1, sent + 1):
        world.tick(k * EVERY, lockstep=False)
    first = len(world.images)
    world.spin_until(lambda: len(world.images) > first, "a picture")
    camera_node.send_signal(signal.SIGTERM)
    assert camera_node.wait(DEADLINE_S) == 0
    output = camera_node.communicate()[0]
    assert "frames dropped" in output
    drawn = world.steps("image")
    assert drawn == sorted(drawn)
    assert len(drawn) < sent


def test_a_run_without_camera_is_refused(tmp_path: Path, world: World) -> None:
    process = start(write_run(tmp_path / "run.json", None))
    output = process.communicate(timeout=DEADLINE_S)[0]
    assert process.returncode == 1
    assert "camera" in output
    assert "Traceback" not in output
