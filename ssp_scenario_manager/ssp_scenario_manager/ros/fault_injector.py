"""The runner's view of a session and its means to disturb it: truth, time, events, references."""

from __future__ import annotations

import time
from typing import Any

from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.cdr.references import decode_reference, encode_reference
from ssp_core.cdr.steps import decode_tick
from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.motion.reference import Reference
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Role, SessionPhase
from ssp_core.world.event_messages import encode_fault
from ssp_core.world.plant import FaultFact
from ssp_msgs.msg import FaultEvent, SafetyEvent, SessionState, WorldTick
from ssp_msgs.msg import Reference as ReferenceMsg
from ssp_msgs.srv import SessionCommand
from ssp_scenario_manager.dispatch import invalid_references

WHO = "ssp run"
_UNITS = {"actuator_stuck": "m/s^2", "clock_step": "s", "link_delay": "s", "position_jump": "m"}
# The object, the recorder and this node hear a reference.
_LISTENERS = 3
_WITNESSED = ("x_m", "y_m", "yaw_rad", "speed_mps")
_OURS = (Role.VUT, Role.OT)


class FaultEndpoints:
    """Sees the true world without the recorder, and does what faults ask for.

    Args:
        started: steady time of the runner's start, s; wall times count from there.
    """

    def __init__(self, node: Node, run: RunSpec, started: float) -> None:
        self._run = run
        self._started = started
        self._now_ns = 0
        self._session = SessionPhase.UNKNOWN
        self._live_since_ns: int | None = None
        self._ticks: list[tuple[float, bytes]] = []
        self._references: dict[str, Reference] = {}
        self._count = 0
        self.runner_events: list[dict[str, Any]] = []
        self._node = node
        self._faults = node.create_publisher(FaultEvent, names.FAULT_EVENT, ros.LATCHED)
        self._abort = node.create_client(SessionCommand, "abort")
        self._strange = {
            target.id: node.create_publisher(
                ReferenceMsg, names.reference_topic(target.id), ros.COMMAND
            )
            for target in run.targets
            if any(f.target == target.id and f.kind.startswith("reference_") for f in run.faults)
        }
        sub = node.create_subscription
        sub(WorldTick, names.WORLD_TICK, self._on_tick, ros.STATE, raw=True)
        sub(SessionState, names.SESSION_STATE, self._on_session, ros.LATCHED)
        sub(SafetyEvent, names.SAFETY_EVENT, self._on_safety, ros.LATCHED)
        sub(FaultEvent, names.FAULT_EVENT, self._on_fault, ros.LATCHED)
        for object_id in self._strange:
            topic, take = names.reference_topic(object_id), self._on_reference
            ros.subscribe_raw(node, ReferenceMsg, topic, decode_reference, take, ros.COMMAND)

    def lacks(self) -> list[str]:
        """Name what a fault may need and isn't seen yet; it would strike too late."""
        has_world = bool(self._ticks) or self._run.mode == "live"
        missing = [] if has_world else [names.WORLD_TICK]
        missing += [
            f"the readers of {publisher.topic_name}"
            for publisher in self._strange.values()
            if publisher.get_subscription_count() < _LISTENERS
        ]
        return missing + ([] if self._abort.service_is_ready() else ["the service abort"])

    @property
    def session_s(self) -> float:
        """Session time of the run, s; 0 before its start."""
        if self._run.mode == "live":
            if self._live_since_ns is None:
                return 0.0
            return ns_to_seconds(time.time_ns() - self._live_since_ns)
        return ns_to_seconds(self._now_ns)

    @property
    def wall_s(self) -> float:
        """Steady time since the runner's start, s."""
        return time.monotonic() - self._started

    def all_stand(self) -> bool:
        """Tell whether the newest truth says that VUT and object targets stand."""
        if not self._ticks:
            return False
        objects = decode_tick(self._ticks[-1][1]).objects
        return all(o.speed_mps == 0.0 for o in objects if o.role in _OURS)

    @property
    def is_over(self) -> bool:
        """Tell whether the session said that it is finished or aborted."""
        return self._session in (SessionPhase.FINISHED, SessionPhase.ABORTED)

    def newest_truth_s(self) -> float | None:
        """Return the wall time of the newest truth, s; None before the first."""
        return self._ticks[-1][0] if self._ticks else None

    def witness(self) -> dict[str, Any]:
        """Return the truth of VUT and objects as it was heard, for a run without a full bag."""
        times, walls = [], []
        objects: dict[str, dict[str, list[float]]] = {}
        for wall_s, raw in self._ticks:
            tick = decode_tick(raw)
            if not tick.running:
                continue
            times.append(ns_to_seconds(tick.stamp_ns))
            walls.append(round(wall_s, 4))
            for one in tick.objects:
                if one.role in _OURS:
                    row = objects.setdefault(one.object_id, {key: [] for key in _WITNESSED})
                    for key, values in row.items():
                        values.append(round(getattr(one, key), 5))
        return {"t_s": times, "wall_s": walls, "objects": objects}

    # -- what faults ask for ---------------------------------------------------------------------

    def abort(self, reason: str) -> None:
        self._abort.call_async(SessionCommand.Request(requested_by=WHO, reason=reason))

    def tell_fault(self, fault: str, target: str, active: bool, value: float) -> None:
        unit = _UNITS.get(fault.partition(" ")[2], "")
        fact = FaultFact(
            self._node.get_name(), fault, target, active, value, unit, self._stamp_ns()
        )
        self._faults.publish(encode_fault(fact))

    def send_strange_reference(self, object_id: str, kind: str) -> None:
        objects = decode_tick(self._ticks[-1][1]).objects
        state = next(o for o in objects if o.object_id == object_id)
        self._count += 1
        name = f"{object_id}-strange-{self._count}"
        current = self._references.get(object_id)
        version, now_ns = self._run.event_version, self._stamp_ns()
        if kind == "reference_stale":
            reference = invalid_references.stale(name, state, current, version, now_ns)
        else:
            reference = invalid_references.out_of_fence(
                name, state, current, version, now_ns, self._run.geofence
            )
        self._strange[object_id].publish(encode_reference(reference))

    # -- what is heard ---------------------------------------------------------------------------

    def _stamp_ns(self) -> int:
        return time.time_ns() if self._run.mode == "live" else self._now_ns

    def _on_tick(self, raw: bytes) -> None:
        self._now_ns = peek_stamp_ns(raw)
        self._ticks.append((self.wall_s, raw))

    def _on_reference(self, reference: Reference) -> None:
        if "-strange-" not in reference.reference_id:
            self._references[reference.object_id] = reference

    def _on_session(self, message: SessionState) -> None:
        if message.state == SessionState.STATE_RUNNING:
            self._live_since_ns = ros.ns_from_stamp(message.header.stamp)
        self._session = SessionPhase(message.state)
        self._hear("session", self._session.name, message.reason, message.header.stamp)

    def _on_safety(self, message: SafetyEvent) -> None:
        who = f"{message.source} {message.object_id}".strip()
        self._hear("safety", message.limit_name, who, message.header.stamp)

    def _on_fault(self, message: FaultEvent) -> None:
        if message.source != self._node.get_name():
            word = "begins" if message.active else "ends"
            self._hear("fault", message.fault, f"{message.target} {word}", message.header.stamp)

    def _hear(self, kind: str, name: str, detail: str, stamp: Any) -> None:
        self.runner_events.append(
            {
                "kind": kind,
                "name": name,
                "detail": detail,
                "session_s": ros.ns_from_stamp(stamp) / NS_PER_S,
                "wall_s": round(self.wall_s, 6),
            }
        )
