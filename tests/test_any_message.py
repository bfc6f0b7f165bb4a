"""No message that a node takes ends it, whatever stands in its fields; what it sends stays sound.

The nodes are real and their callbacks are called as the executor would call them, with messages
made from the fields of their types: each field in turn and two at once take values from the ends of
what the wire allows. After each the node's timers run, so that it steps and sends.
"""

from __future__ import annotations

import importlib
import json
import math
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import rclpy
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from ssp_core import names, ros
from ssp_core.cdr import steps
from ssp_core.cdr.states import encode_state
from ssp_core.host.domains import free_domain
from ssp_core.host.shared_memory import remove_shared_ports, remove_stale_shared_memory
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec, load_run
from ssp_core.safety.arming import Facts
from ssp_core.safety.object_rules import rules_of
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_monitor.ros.monitor_node import MonitorNode
from ssp_monitor.ros.page_node import MonitorPage
from ssp_monitor.ros.view_node import ViewNode
from ssp_msgs.msg import HeartbeatReply, RecorderStatus, SessionState, WorldTick
from ssp_msgs.srv import ObjectCommand
from ssp_ot_controller.objects.pool import ObjectPool
from ssp_ot_controller.ros.front_camera import FrontCamera
from ssp_ot_controller.ros.object_target import ObjectTargetNode
from ssp_ot_controller.ros.sil_world import SilWorld
from ssp_ot_controller.ros.vut_adapter import VutAdapter
from ssp_scenario_manager.ros.manager_node import ScenarioManager
from ssp_scenario_manager.session.session import Session
from ssp_scenario_manager.session.state_machine import SessionEvent
from ssp_vla_bridge.ros.vla_bridge import VlaBridge
from tests.support.runs import cut_in_run
from tests.support.states import object_state

# States of this test move at will, and no wall's clock ends its sessions.
RUN: dict[str, Any] = {
    **cut_in_run(),
    "mode": "realtime",
    "geofence": [(-20.0, -8.0), (400.0, -8.0), (400.0, 12.0), (-20.0, 12.0)],
    "end": {"at_latest_s": 86_400.0},
}
RUN["limits"] |= {"heartbeat_s": 60.0, "ack_s": 60.0, "duration_s": 86400.0}
STEP_NS = 20_000_000


# -- messages -------------------------------------------------------------------------------------

# Becomes bytes that are no UTF-8, which only a sender without Python can put on the wire.
BROKEN = "~~~~"
NO_UTF8 = b"\xff\xfe\xfd\xc0"
LONG = "x" * 1_000_000
TEXTS = ("", BROKEN, "\n\x1b[2J%s{}", LONG, "é\u202e\U0001f600")
FLOATS = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1e8, -1e12, 1e200, sys.float_info.max)
SINGLES = (math.nan, math.inf, -math.inf, 0.0, -1.0, 3.4028234663852886e38)


def _ints(bits: int, signed: bool) -> tuple[int, ...]:
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    wanted = {low, -1, 0, 5, 10, 200, 10**9, 1 << 53, high}
    return tuple(sorted(value for value in wanted if low <= value <= high))


EXTREMES: dict[str, tuple[Any, ...]] = {
    "string": TEXTS,
    "double": FLOATS,
    "float": SINGLES,
    "boolean": (False, True),
    "octet": (b"\x00", b"\xff"),
    **{f"int{n}": _ints(n, True) for n in (8, 16, 32, 64)},
    **{f"uint{n}": _ints(n, False) for n in (8, 16, 32, 64)},
}
PLAIN: dict[str, Any] = {
    "string": "ot1",
    "double": 1.0,
    "float": 1.0,
    "boolean": True,
    "octet": b"\x01",
}
_SHAPE = re.compile(r"(sequence<)?([\w/]+)(?:<\d+>)?(?:, \d+>|>|\[(\d+)\])?")


def shape(kind: str) -> tuple[str, int | None]:
    """A field's item and how many there are: -1 for a sequence, None for a single one."""
    found = _SHAPE.fullmatch(kind)
    assert found is not None, kind
    count = -1 if found[1] else int(found[3]) if found[3] else None
    return found[2], count


def class_of(kind: str) -> Any:
    package, _, name = kind.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def plain(cls: Any, topic: str, now_ns: int) -> Any:
    """A message of a type that a node may take for one of its session's."""
    message = cls()
    if cls.__name__ == "Time":
        return ros.stamp_from_ns(now_ns)
    for name, kind in cls.get_fields_and_field_types().items():
        item, count = shape(kind)
        one = plain(class_of(item), topic, now_ns) if "/" in item else PLAIN.get(item, 1)
        if name == "frame_id":
            one = names.MAP_FRAME
        elif name == "object_id" and topic.endswith("vut/state"):
            one = names.VUT_ID
        if count is None:
            setattr(message, name, one)
        elif item == "ssp_msgs/ObjectState":
            two = plain(class_of(item), topic, now_ns)
            one.object_id, two.object_id = names.VUT_ID, "ot1"
            setattr(message, name, [one, two])
        else:
            setattr(message, name, [one] * (2 if count < 0 else count))
    return message


Put = Callable[[Any], None]


def places(cls: Any) -> list[tuple[str, list[Put]]]:
    """Each field of a type, those of its parts too: its path and what can be put into it."""
    found: list[tuple[str, list[Put]]] = []
    for name, kind in cls.get_fields_and_field_types().items():
        item, count = shape(kind)
        values: list[Any] = []
        if "/" not in item:
            values = list(EXTREMES[item])
            if count is not None:
                n = 3 if count < 0 else count
                values = [[value] * n for value in values if value != LONG]
        elif count is None:
            found += [
                (f"{name}.{path}", [partial(_within, name, put) for put in puts])
                for path, puts in places(class_of(item))
            ]
        else:
            found += [
                (f"{name}[].{path}", [partial(_within_all, name, put) for put in puts])
                for path, puts in places(class_of(item))
            ]
        if count is not None and count < 0:
            values.append([])
        if values:
            found.append((name, [partial(_put, name, value) for value in values]))
    return found


def _put(name: str, value: Any, message: Any) -> None:
    setattr(message, name, value)


def _within(name: str, put: Put, message: Any) -> None:
    put(getattr(message, name))


def _within_all(name: str, put: Put, message: Any) -> None:
    for part in getattr(message, name):
        put(part)


def wire(message: Any) -> bytes:
    return bytes(serialize_message(message)).replace(BROKEN.encode(), NO_UTF8)


# -- nodes ----------------------------------------------------------------------------------------


class Struck:
    """A node, and how it is brought back to where it listens to everything."""

    def __init__(self, node: Any) -> None:
        self.node = node
        self.now_ns = 1_000_000_000
        self.sound: dict[Any, Any] = {}

    def hears(self) -> list[tuple[str, Any, Callable[[bytes], None]]]:
        """Topic, type and reception of each of its subscriptions."""
        heard = [one for one in self.node.subscriptions if one.topic_name.startswith("/ssp")]
        return [(one.topic_name, one.msg_type, partial(self._hear, one)) for one in heard]

    def _hear(self, subscription: Any, data: bytes) -> None:
        if subscription.raw:
            subscription.callback(data)
        else:
            subscription.callback(deserialize_message(data, subscription.msg_type))

    def tell(self, topic: str, data: bytes) -> None:
        for heard, _, hear in self.hears():
            if heard == names.absolute(topic):
                hear(data)

    def ready(self) -> None:
        """Brings it to where what it hears matters most."""

    def step(self) -> None:
        """Lets all of its timers run once, and sends it a little of what it should hear."""
        self.now_ns += STEP_NS
        for timer in list(self.node.timers):
            timer.callback()

    def close(self) -> None:
        self.node.destroy_node()


def state(object_id: str, now_ns: int, **given: Any) -> ObjectState:
    place = {} if object_id == "vut" else {"x_m": 40.0, "y_m": 3.5}
    stamped = {"stamp_ns": now_ns, "sequence": now_ns // STEP_NS}
    return object_state(object_id, **{**place, **stamped, **given})


class Manager(Struck):
    def __init__(self, run_file: Path) -> None:
        super().__init__(ScenarioManager())
        self.run = load_run(run_file)

    def ready(self) -> None:
        session = self.node._session
        if session.state is SessionPhase.RUNNING:
            return
        vars(session).update(vars(Session()))
        self.answer()
        self.now_ns += STEP_NS
        spec = self.run
        assert session.load(spec, self.now_ns).accepted
        self.node._links.connect(("ot1",), spec.states_in_one)
        for event in (SessionEvent.CONNECT, SessionEvent.ARM, SessionEvent.START):
            armed = event is SessionEvent.START
            self.hear(ControlState.ARMED if armed else ControlState.DISARMED)
            session.facts = Facts.of_one_process(spec)
            answer = session.command(event, self.now_ns, "test", "")
            assert answer.accepted, answer
        session.outbox.clear()

    def hear(self, control: ControlState) -> None:
        tick = steps.WorldTick(self.now_ns, 1, False, False, 0, 0)
        self.tell(names.WORLD_TICK, steps.encode_tick(tick))
        self.tell("vut/state", encode_state(state("vut", self.now_ns)))
        self.tell("ot1/state", encode_state(state("ot1", self.now_ns, control_state=control)))

    def step(self) -> None:
        self.now_ns += STEP_NS
        tick = steps.WorldTick(self.now_ns, 2, True, False, 0, 0)
        self.tell(names.WORLD_TICK, steps.encode_tick(tick))
        running = state("ot1", self.now_ns, control_state=ControlState.RUNNING)
        self.tell("ot1/state", encode_state(running))
        self.tell("vut/state", encode_state(state("vut", self.now_ns)))
        self.answer()
        super().step()

    def answer(self) -> None:
        """The object and the recorder are well, too."""
        self.node._send_heartbeat()
        sequence, sent_ns = list(self.node._liveness.links._beats.items())[-1]
        stamp = ros.stamp_from_ns(sent_ns)
        reply = HeartbeatReply(
            object_ids=["ot1"], sequence=sequence, heartbeat_sent=stamp, heartbeat_received=stamp
        )
        reply.header.stamp = stamp
        self.tell(names.HEARTBEAT_REPLY, wire(reply))
        self.tell(names.RECORDER_STATUS, wire(RecorderStatus(ready=True)))


class Objects(Struck):
    def __init__(self, run_file: Path) -> None:
        super().__init__(ObjectTargetNode(ros.StopRequest()))
        self.sequence = 0
        self.run = RunSpec.model_validate(RUN)

    def ready(self) -> None:
        pool = self.node._process.pool
        if pool.state_of("ot1") is ControlState.RUNNING:
            return
        vars(pool).update(vars(ObjectPool(self.run, (), time.monotonic_ns())))
        pool.active = True
        self.now_ns, self.sequence = self.now_ns + STEP_NS, 0
        self.beat(SessionPhase.CONNECTED)
        self.tick()
        version = self.run.event_version
        for _ in range(2):
            asked = ObjectCommand.Request(
                command=ObjectCommand.Request.COMMAND_ARM,
                event_version=version,
                rules_digest=rules_of(self.run, "ot1").digest,
            )
            service = next(iter(s for s in self.node.services if "ot1/command" in s.srv_name))
            answer = service.callback(asked, ObjectCommand.Response())
            self.tick()
            if pool.state_of("ot1") is ControlState.ARMED:
                break
        assert pool.state_of("ot1") is ControlState.ARMED, answer
        self.beat(SessionPhase.RUNNING)
        self.tick()
        assert pool.state_of("ot1") is ControlState.RUNNING

    def beat(self, phase: SessionPhase) -> None:
        self.sequence += 1
        beat = steps.Heartbeat(self.now_ns, "m", self.sequence, time.time_ns(), phase, {"ot1": 0})
        self.tell(names.HEARTBEAT, steps.encode_heartbeat(beat))

    def tick(self) -> None:
        self.now_ns += STEP_NS
        objects = (state("ot1", self.now_ns), state("vut", self.now_ns))
        tick = steps.WorldTick(self.now_ns, self.now_ns // STEP_NS, True, False, 0, 0, objects)
        self.tell(names.WORLD_TICK, steps.encode_tick(tick))

    def step(self) -> None:
        self.tick()
        super().step()


class Recorder(Struck):
    """The recorder, which decodes the messages that it listens to, and none that it writes."""

    def hears(self) -> list[tuple[str, Any, Callable[[bytes], None]]]:
        return [
            (names.SESSION_STATE, SessionState, self.node._hear),
            (names.WORLD_TICK, WorldTick, self._pace),
        ]

    def _pace(self, data: bytes) -> None:
        with suppress(ValueError):  # Intake tells of it and goes on.
            self.node._keep_pace(data)

    def close(self) -> None:
        self.node._last_word.hear(SessionPhase.FINISHED, 1, (), "r")
        self.node.recording.close()
        super().close()


class World(Struck):
    def ready(self) -> None:
        self.node._running, self.node._over = True, False
        self.node._session = SessionPhase.RUNNING

    def close(self) -> None:
        self.node._surroundings.close()
        super().close()


class Page(Struck):
    def step(self) -> None:
        super().step()
        self.node._watch.settle()
        now_ns = time.monotonic_ns()
        self.node._pictures.settle()
        snapshot = self.node._snapshots.snapshot(now_ns)
        json.dumps(snapshot, allow_nan=False).encode()
        json.dumps(self.node._snapshots.events(), allow_nan=False).encode()

    def close(self) -> None:
        self.node.close()
        super().close()


class Bridge(Struck):
    def step(self) -> None:
        super().step()
        give_up_s = time.monotonic() + 30.0
        while self.node._queue.busy and time.monotonic() < give_up_s:
            time.sleep(0.001)
        assert not self.node._queue.busy
        assert self.node._worker.is_alive()

    def close(self) -> None:
        self.node.shutdown()
        super().close()


class Camera(Struck):
    def step(self) -> None:
        while self.node._waiting:
            self.node._waiting.popleft().result()
        super().step()

    def close(self) -> None:
        self.node.close()
        super().close()


MAKERS: dict[str, Callable[[Path], Struck]] = {
    "scenario_manager": Manager,
    "object_target": Objects,
    "sil_world": lambda _: World(SilWorld(ros.StopRequest())),
    "front_camera": lambda _: Camera(FrontCamera(ros.StopRequest())),
    "monitor": lambda _: Recorder(MonitorNode()),
    "monitor_page": lambda _: Page(MonitorPage(ros.StopRequest())),
    "view": lambda _: Struck(ViewNode()),
    "vla_bridge": lambda _: Bridge(ros.make_node("vla_bridge", VlaBridge)),
    "vut_adapter": lambda _: Struck(VutAdapter(ros.StopRequest())),
    "vut_adapter of places": lambda _: Struck(VutAdapter(ros.StopRequest())),
}
CAMERA = {"width_px": 64, "height_px": 64, "rate_hz": 10.0}


@pytest.fixture(scope="module", params=list(MAKERS))
def tested(request: pytest.FixtureRequest, tmp_path_factory: Any) -> Iterator[Struck]:
    folder = tmp_path_factory.mktemp(request.param)
    run_file = folder / "run.yaml"
    changes: dict[str, Any] = {}
    if request.param.startswith("vut_adapter"):
        changes |= {"mode": "live", "datum": {"latitude_deg": 57.8, "longitude_deg": 12.8}}
    if request.param == "front_camera":
        changes["camera"] = CAMERA
    run_file.write_text(json.dumps(RUN | changes))
    given_ = {
        "run_file": run_file,
        "bag_dir": folder / "bag",
        "port": 0,
        "model": "constant_velocity",
        "shadow_hz": 10.0,
    }
    if request.param == "vut_adapter of places":
        given_ |= {"navsat": "fix", "heading": "imu"}
    arguments = ["--ros-args", *(w for k, v in given_.items() for w in ("-p", f"{k}:={v}"))]
    with free_domain() as domain:
        rclpy.init(args=arguments, domain_id=domain)
        one = MAKERS[request.param](run_file)
        one.ready()  # a manager hears an object once it has a run
        yield one
        one.close()
        rclpy.shutdown()
        remove_shared_ports(domain)
    remove_stale_shared_memory()


def strike(one: Struck, topic: str, hear: Callable[[bytes], None], message: Any) -> None:
    one.ready()
    hear(wire(message))
    one.step()


def test_each_field_may_hold_anything(tested: Struck) -> None:
    for topic, cls, hear in tested.hears():
        for path, puts in places(cls):
            for put in puts:
                message = plain(cls, topic, tested.now_ns + STEP_NS)
                put(message)
                try:
                    strike(tested, topic, hear, message)
                except Exception as error:
                    error.add_note(f"{topic}: {path} is {str(put.args)[-60:]}")
                    raise


@settings(max_examples=100)
@given(st.data())
def test_and_so_may_three_at_once(tested: Struck, data: st.DataObject) -> None:
    topic, cls, hear = data.draw(st.sampled_from(tested.hears()), "topic")
    message = plain(cls, topic, tested.now_ns + STEP_NS)
    for path, puts in data.draw(st.lists(st.sampled_from(places(cls)), max_size=3), "fields"):
        data.draw(st.sampled_from(puts), path)(message)
    strike(tested, topic, hear, message)
