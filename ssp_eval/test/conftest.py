"""A small recorded run, written without ROS: what evaluation reads."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.types import serialize, typestore
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.files.writing import write_json, write_text
from ssp_core.vocabulary import ControlState, ObjectClass, Role, SessionPhase, Verdict
from ssp_scenario_manager.compile.task import Task, sealed
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.log import Record, append_record
from ssp_scenario_manager.maps.site import Site, find_shipped, site_version

VERSION = "sha256:" + "1" * 64
STEP_NS = 20_000_000
FRAME_STEPS = 5
LEAD_STEPS = 25  # steps before the session runs
LANE_M = 3.5
# Log times are receive times of a wall clock: not the stamps, and not even at their pace.
LOG_START_NS = 1_700_000_000_000_000_000


def run_file(scenario: str, domain: str, stand_in: bool) -> dict[str, Any]:
    """A valid run file; nothing here reads more of it than names, camera and thresholds."""
    path = [[0.0, 0.0], [400.0, 0.0]]
    return {
        "schema": "ssp.run/1",
        "run_id": "r1",
        "scenario": scenario,
        "interaction": "cut_in",
        "domain": domain,
        "stand_in": stand_in,
        "event_version": VERSION,
        "site": "made_up",
        "site_version": "sha256:" + "2" * 64,
        "seed": 1,
        "mode": "lockstep",
        "road": {
            "origin": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0},
            "length_m": 400.0,
            "lanes": [{"y_m": 0.0, "width_m": LANE_M, "direction": "forward"}],
        },
        "geofence": [[0.0, -9.0], [400.0, -9.0], [400.0, 9.0]],
        "vut": {
            "id": "vut",
            "object_class": "car",
            "start": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0},
        },
        "driver": {"cruise_mps": 10.0},
        "targets": [
            {
                "id": "ot1",
                "object_class": "car",
                "start": {"x_m": 14.0, "y_m": -LANE_M, "yaw_rad": 0.0},
            }
        ],
        "triggers": [
            {
                "id": "t1",
                "condition": {"type": "relative_distance", "object_id": "ot1", "below_m": 15.0},
                "object_id": "ot1",
                "manoeuvre": {
                    "kind": "follow_path",
                    "motion": {"path": path, "cruise_mps": 9.0},
                },
            }
        ],
        "limits": {"speed_mps": 20.0, "acceleration_mps2": 6.0},
    }


class RunBag:
    """Writes messages of the recorder's topics at stamps."""

    def __init__(self, path: Path) -> None:
        self.types = typestore().types
        self.writer = BagWriter(path)
        self.count = 0
        self.topics: set[str] = set()

    def header(self, stamp_ns: int, frame: str = "map") -> Any:
        time = self.types["builtin_interfaces/msg/Time"](
            sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9
        )
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)

    def write(self, topic: str, message: Any, stamp_ns: int) -> None:
        if topic not in self.topics:
            self.topics.add(topic)
            latched = topic.rpartition("/")[2] in ("session_state", "camera_info", "mount")
            qos = offered_qos(10, transient_local=latched)
            self.writer.add_topic(topic, message.__msgtype__, qos)
        self.count += 1
        log_ns = LOG_START_NS + self.count * 1_000_000
        self.writer.write(topic, serialize(message), log_ns, log_ns - 500)

    def state(
        self,
        stamp_ns: int,
        name: str,
        role: Role,
        pose: tuple[float, ...],
        control: ControlState = ControlState.RUNNING,
    ) -> Any:
        x, y, yaw, speed, acceleration = pose
        return self.types["ssp_msgs/msg/ObjectState"](
            header=self.header(stamp_ns),
            object_id=name,
            object_class=int(ObjectClass.CAR),
            role=int(role),
            control_state=int(control),
            sequence=1,
            x=x,
            y=y,
            yaw=yaw,
            speed=speed,
            acceleration=acceleration,
            yaw_rate=0.0,
            front=3.6,
            rear=0.9,
            width=1.8,
            height=1.5,
            position_std=0.0,
            reference_id="",
            error_longitudinal=0.0,
            error_lateral=0.0,
            error_yaw=0.0,
        )

    def tick(self, stamp_ns: int, step: int, objects: list[Any]) -> Any:
        """A tick with its lockstep counters at 0, which no test here reads."""
        cls: Any = self.types["ssp_msgs/msg/WorldTick"]
        given = {"header": self.header(stamp_ns), "step": step, "running": True, "lockstep": True}
        counters = {
            f.name: 0
            for f in fields(cls)
            if f.init and f.name not in (*given, "objects", "__msgtype__")
        }
        return cls(**given, **counters, objects=objects)

    def frame(self, stamp_ns: int, jpeg: bytes) -> None:
        image = self.types["sensor_msgs/msg/CompressedImage"](
            header=self.header(stamp_ns, "vut/front_camera_optical"),
            format="jpeg",
            data=np.frombuffer(jpeg, dtype=np.uint8),
        )
        self.write("/ssp/vut/front_camera/image/compressed", image, stamp_ns)

    def camera(self, stamp_ns: int, width: int = 96) -> None:
        """16:9, 75° across, 1.45 m high, 1.8 m ahead, looking 0.03 rad down."""
        height = width * 9 // 16
        u, v = width / 2, height / 2
        focal = u / math.tan(math.radians(37.5))
        roi = self.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        info = self.types["sensor_msgs/msg/CameraInfo"](
            header=self.header(stamp_ns),
            height=height,
            width=width,
            distortion_model="plumb_bob",
            d=np.zeros(5),
            k=np.array([focal, 0, u, 0, focal, v, 0, 0, 1.0]),
            r=np.eye(3).ravel(),
            p=np.zeros(12),
            binning_x=0,
            binning_y=0,
            roi=roi,
        )
        self.write("/ssp/vut/front_camera/camera_info", info, stamp_ns)
        # Columns: the optical x, y, z axes in base_link (right, down, ahead), pitched down.
        half = (math.pi / 2 + 0.03) / 2
        yaw = (math.cos(-math.pi / 4), math.sin(-math.pi / 4))
        # Rotation about z by -90°, then about the new x by -(90° + pitch).
        w, x = math.cos(-half), math.sin(-half)
        quaternion = self.types["geometry_msgs/msg/Quaternion"](
            x=yaw[0] * x, y=yaw[1] * x, z=yaw[1] * w, w=yaw[0] * w
        )
        mount = self.types["geometry_msgs/msg/TransformStamped"](
            header=self.header(stamp_ns, "vut/base_link"),
            child_frame_id="vut/front_camera_optical",
            transform=self.types["geometry_msgs/msg/Transform"](
                translation=self.types["geometry_msgs/msg/Vector3"](x=1.8, y=0.0, z=1.45),
                rotation=quaternion,
            ),
        )
        self.write("/ssp/vut/front_camera/mount", mount, stamp_ns)

    def session(self, stamp_ns: int, phase: SessionPhase, verdict: Verdict, why: list[str]) -> None:
        message = self.types["ssp_msgs/msg/SessionState"](
            header=self.header(stamp_ns),
            state=int(phase),
            previous=0,
            event="test",
            reason="",
            run_id="r1",
            scenario="cut_in",
            event_version=VERSION,
            verdict=int(verdict),
            reasons=why,
        )
        self.write("/ssp/session_state", message, stamp_ns)


def picture(index: int) -> bytes:
    """A small JPEG that differs from frame to frame."""
    image = np.full((54, 96, 3), 90, np.uint8)
    image[27:, :] = (60, 60, 60)
    cv2.rectangle(image, (index % 90, 20), (index % 90 + 6, 30), (0, 0, 200), -1)
    cv2.putText(image, str(index), (2, 50), cv2.FONT_HERSHEY_PLAIN, 0.8, (255, 255, 255))
    return cv2.imencode(".jpg", image)[1].tobytes()


def poses(t_s: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """VUT at 10 m/s, and a car that changes into its lane from the right between 4 and 6.5 s."""
    progress = min(max((t_s - 4.0) / 2.5, 0.0), 1.0)
    y_m = -LANE_M * 0.5 * (1.0 + math.cos(math.pi * progress))
    left = LANE_M * 0.5 * math.pi / 2.5 * math.sin(math.pi * progress) if 0 < progress < 1 else 0.0
    car = (14.0 + 9.0 * t_s, y_m, math.atan2(left, 9.0), math.hypot(9.0, left), 0.0)
    return (10.0 * t_s, 0.0, 0.0, 10.0, 0.0), car


def k_star_poses(
    t_s: float,
    change_s: float = 2.5,
    braking_s: float = 2.0,
    slowing_mps2: float = 3.0,
    ahead_m: float = 38.0,
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """VUT at 13 m/s; a car at 8.5 m/s changes into its lane from the left, and the VUT brakes.

    Args:
        t_s: the car begins at 3 s, the VUT at 5 s.
        change_s: how long the change of lanes takes.
        braking_s: how long the VUT brakes.
        slowing_mps2: how hard.
        ahead_m: how far ahead the car is at first.
    """
    braked_s = min(max(t_s - 5.0, 0.0), braking_s)
    speed = 13.0 - slowing_mps2 * braked_s
    x_m = 13.0 * min(t_s, 5.0) + 13.0 * braked_s - slowing_mps2 / 2.0 * braked_s**2
    x_m += speed * max(t_s - 5.0 - braking_s, 0.0)
    progress = min(max((t_s - 3.0) / change_s, 0.0), 1.0)
    y_m = LANE_M * 0.5 * (1.0 + math.cos(math.pi * progress))
    turning = 0 < progress < 1
    right = LANE_M * 0.5 * math.pi / change_s * math.sin(math.pi * progress) if turning else 0.0
    yaw, pace = math.atan2(-right, 8.5), math.hypot(8.5, right)
    slowing = -slowing_mps2 if 0.0 < braked_s < braking_s else 0.0
    return (x_m, 0.0, 0.0, speed, slowing), (ahead_m + 8.5 * t_s, y_m, yaw, pace, 0.0)


def lanes_of(count: int) -> list[dict[str, Any]]:
    """Lanes in the VUT's direction, from the right; where there are several, as many oncoming."""
    words = ["forward"] * count + ["backward"] * (count if count > 1 else 0)
    return [
        {"y_m": LANE_M * n, "width_m": LANE_M, "direction": word} for n, word in enumerate(words)
    ]


def made_up_site(domain: str, lanes: int = 1) -> Site:
    """One straight block."""
    limits = {"speed_mps": 20.0, "acceleration_mps2": 6.0}
    whole = {"block": "main", "from_s_m": 0, "to_s_m": 400, "from_l_m": -9, "to_l_m": 9}
    return Site.model_validate(
        {
            "schema": "ssp.site/1",
            "name": "made_up",
            "description": "a straight road",
            "domain": domain,
            "stand_in": False,
            "blocks": [
                {
                    "id": "main",
                    "origin": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0},
                    "pieces": [{"length_m": 400.0}],
                    "lanes": lanes_of(lanes),
                    "road_type": "urban",
                    "left_boundary": "kerb",
                    "right_boundary": "kerb",
                    "permitted": ["keep_lane"],
                    "speed_limit_mps": 13.9,
                }
            ],
            "ot_reachable": [whole],
            "safe_stop_zones": [whole],
            "geofence": whole,
            "limits": limits,
        }
    )


def made_up_task(site: Site, event_name: str, validated_by: dict[str, str] | None) -> Task:
    """A task as a compiler leaves it; its run is that of run_file."""
    event, version = load_event(event_name)
    event_name = event.name
    links = {"event_version": version, "site_version": site_version(site)}
    run = {**run_file(event_name, site.domain, site.stand_in), **links}
    run["road"] = {**run["road"], "lanes": [lane.model_dump() for lane in site.blocks[0].lanes]}
    here = {"s_m": 100.0, "l_m": 0.0, "x_m": 100.0, "y_m": 0.0}
    block = site.blocks[0].model_dump(mode="json")
    task = Task.model_validate(
        {
            "schema": "ssp.task/1",
            "target": "sumo" if site.domain == "simulation" else "track",
            "event": {"name": event_name, "version": version},
            "compiler": "ssp test",
            "seed": 1,
            "place": {"kind": "site", "name": site.name, "sha256": site_version(site)},
            "block": {k: block[k] for k in ("id", "origin", "pieces", "lanes")}
            | {"length_m": 400.0},
            "chosen_by": "highest score",
            "retrieval": [],
            "anchors": {"vut": {"start": here, "goal": here, "conflict": here}},
            "vut_route": [(0.0, 0.0), (400.0, 0.0)],
            "trigger": {
                "quantity": "relative_distance",
                "object_id": "ot1",
                "below": 15.0,
                "unit": "m",
                "expected": here,
            },
            "conflict_zone": [here],
            "limits": run["limits"],
            "geofence": run["geofence"],
            "tunings": [],
            "validated_by": validated_by,
            "run": run,
        }
    )
    return sealed(task)


def write_task(
    folder: Path,
    domain: str = "simulation",
    event: str = "cut_in",
    validated_by: dict[str, str] | None = None,
    lanes: int = 1,
) -> Path:
    """Writes a compiled folder without a compiler."""
    site = made_up_site(domain, lanes)
    task = made_up_task(site, event, validated_by)
    write_text(folder / "task.json", task.model_dump_json(by_alias=True, indent=1))
    write_text(folder / "site.yaml", site.model_dump_json(by_alias=True, indent=1))
    write_text(folder / "run.yaml", task.run.model_dump_json(by_alias=True, indent=1))
    write_text(folder / "event.yaml", find_shipped(event, "event").read_text())
    record = {
        "kind": "tuning",
        "when": "2025-03-01T09:00:00Z",
        "who": "ssp compile",
        "subject": f"task {task.event.name}",
        "version": task.version,
        "reason": "middle of the range",
    }
    append_record(folder / "log.jsonl", Record.model_validate(record))
    return folder


def write_bag(
    path: Path,
    scenario: str = "cut_in",
    domain: str = "simulation",
    verdict: Verdict = Verdict.VALID,
    reasons: tuple[str, ...] = (),
    stand_in: bool = False,
    frames: bool = True,
    duration_s: float = 9.0,
    task: Path | None = None,
    told: bool = True,
    like_k_star: bool = False,
    pace: tuple[float, ...] | None = None,
    reported: ControlState | None = None,
    declared: Mapping[str, str] | None = None,
    driver: str | None = None,
) -> Path:
    """Writes a recorded cut-in of 9 s at 50 Hz with frames at 10 Hz; simulated time is not 0.

    With a compiled folder, its files are the attachments.

    Args:
        told: write verdict.json too, as the runner does.
        like_k_star: the scene of the shipped cut_in rather than the simpler one: from the left,
            far enough ahead, and seen by a camera of 640×360 px.
        pace: the scene of K* so many seconds later and at another pace, see k_star_poses.
        reported: no world states, as in a live session; both report their own with this control
            state.
        declared: by participant, what it declares, words apart by commas; the session is live then.
        driver: leads the VUT in a driven session.
    """

    def scene(t_s: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        if pace is not None:
            return k_star_poses(t_s - pace[0], *pace[1:])
        return k_star_poses(t_s) if like_k_star else poses(t_s)

    bag = RunBag(path)
    start_ns = LEAD_STEPS * STEP_NS
    with bag.writer:
        content = run_file(scenario, domain, stand_in)
        if declared is not None:
            content |= {"mode": "live"}
        if driver is not None:
            times = {"first_request_s": 0.0, "hand_over_s": 1.0, "end_s": 9.0}
            content |= {"driven": {"driver": driver, **times}}
            path_to = {"path": [[0.0, 0.0], [300.0, 0.0]], "cruise_mps": 10.0}
            content["vut"] = {**content["vut"], "approach": path_to}
        run = json.dumps(content).encode()
        if task is not None:
            run = (task / "run.yaml").read_bytes()
            for file in sorted(task.iterdir()):
                if file.name != "run.yaml":
                    bag.writer.attach(file.name, file.read_bytes(), "text/plain")
        bag.writer.attach("run.yaml", run, "application/yaml")
        bag.session(0, SessionPhase.ARMED, Verdict.NONE, [])
        bag.camera(0, 640 if like_k_star else 96)
        for who, kind in (declared or {}).items():
            for word in kind.split(","):
                bag.write(f"/ssp/declared/{who}", bag.types["std_msgs/msg/String"](data=word), 0)
        for k in range(LEAD_STEPS + round(duration_s * 50)):
            stamp_ns = k * STEP_NS
            if stamp_ns == start_ns:
                bag.session(stamp_ns, SessionPhase.RUNNING, Verdict.NONE, [])
            own, other = scene((stamp_ns - start_ns) / 1e9)
            control = ControlState.RUNNING if reported is None else reported
            vut = bag.state(stamp_ns, "vut", Role.VUT, own, control)
            car = bag.state(stamp_ns, "ot1", Role.OT, other, control)
            if reported is None:
                tick = bag.tick(stamp_ns, k, [car, vut])
                bag.write("/ssp/world/tick", tick, stamp_ns)
            else:
                bag.write("/ssp/ot1/state", car, stamp_ns)
            bag.write("/ssp/vut/state", vut, stamp_ns)
            if frames and k % FRAME_STEPS == 0:
                bag.frame(stamp_ns, picture(k))
        bag.session(k * STEP_NS, SessionPhase.FINISHED, verdict, list(reasons))
    if told:
        word = {"schema": "ssp.verdict/1", "verdict": verdict.name.lower()}
        write_json(bag.writer.path / "verdict.json", {**word, "reasons": list(reasons)})
    return bag.writer.path


@pytest.fixture(scope="session")
def bag_writer(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """write_bag, for fixtures that outlive a test; the same bag is written once and copied."""
    written: dict[tuple[str, str], Path] = {}

    def write(path: Path, *given: object, **options: Any) -> Path:
        if options.get("task") is not None:
            return write_bag(path, *given, **options)
        key = path.name, repr((given, sorted(options.items())))
        if key not in written:
            written[key] = write_bag(tmp_path_factory.mktemp("bag") / path.name, *given, **options)
        return Path(shutil.copytree(written[key], path))

    return write


@pytest.fixture(scope="session")
def task_writer() -> Callable[..., Path]:
    """write_task, for fixtures that outlive a test."""
    return write_task


@pytest.fixture(scope="session")
def poses_of_k_star() -> Callable[..., tuple[tuple[float, ...], tuple[float, ...]]]:
    """k_star_poses: x, y, yaw, speed and acceleration of VUT and car at a time."""
    return k_star_poses


@pytest.fixture
def make_task(tmp_path: Path) -> Callable[..., Path]:
    """write_task into the test's folder."""
    return lambda name="compiled", **options: write_task(tmp_path / name, **options)


@pytest.fixture
def make_bag(tmp_path: Path, bag_writer: Callable[..., Path]) -> Callable[..., Path]:
    """write_bag into the test's folder."""
    return lambda name="bag", *given, **options: bag_writer(tmp_path / name, *given, **options)
