"""The connections of a live session before its start, for the summary above the prompt."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo

from ssp_core import names, ros
from ssp_core.cdr.codec import MOST_TEXT
from ssp_core.cdr.states import StateArray, decode_state, decode_states
from ssp_core.clock import seconds_to_ns
from ssp_core.motion.state import ObjectState as State
from ssp_core.ros.conversions import body_status_of
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participation import Participation, declaring
from ssp_core.safety.arming import Facts
from ssp_core.safety.body_status import BodyStatus, known_bodies
from ssp_core.safety.liveness import ADAPTER_SILENT_S
from ssp_core.safety.publishers import MOST_TOLD, known_strangers
from ssp_msgs.msg import BodyStatus as BodyStatusMsg
from ssp_msgs.msg import (
    LinkStatus,
    LocalisationStatus,
    ObjectState,
    ObjectStates,
    RecorderStatus,
)


class StartListener:
    """Remembers the newest states, and what else is said. Spun by the node's owner.

    The processes of live objects, and of the VUT's localisation, say why there is no state and what
    keeps an object from being armed.

    Args:
        node: owns the subscriptions until ``close``.
    """

    def __init__(self, node: Node, spec: RunSpec) -> None:
        self._node, self._spec, self._ids = node, spec, set(spec.object_ids)
        self._targets = [target.id for target in spec.targets]
        self._bodies: dict[str, tuple[BodyStatus, int]] = {}
        self._vut_refused = ""
        self._strangers: tuple[list[str], float] = [], -math.inf
        self._rivals: list[str] = []
        self._states: dict[str, tuple[State, float]] = {}
        self._recorder_ready = False
        self._sign_times_s: dict[str, float] = {}
        participants = declaring(spec) if spec.mode == "live" else ()
        self._declared: dict[str, list[str]] = {who: [] for who in participants}
        alone = [spec.vut.id] if spec.states_in_one else spec.object_ids
        self._subscriptions: list[Any] = [
            ros.subscribe_raw(
                node, ObjectState, names.state_topic(i), decode_state, self._on_state, ros.STATE
            )
            for i in alone
        ]
        if spec.states_in_one:
            topic = names.OBJECT_STATES
            self._subscriptions.append(
                ros.subscribe_raw(
                    node, ObjectStates, topic, decode_states, self._on_array, ros.STATE
                )
            )
        sub = node.create_subscription
        self._subscriptions += [
            sub(RecorderStatus, names.RECORDER_STATUS, self._on_recorder, ros.STATE),
            sub(CameraInfo, names.CAMERA_INFO, self._on_camera, ros.SENSOR),
            sub(BodyStatusMsg, names.BODY_STATUS, self._on_body, ros.STATE),
            sub(LinkStatus, names.LINK_STATUS, self._on_links, ros.STATE),
            sub(LocalisationStatus, names.LOCALISATION_STATUS, self._on_localisation, ros.STATE),
            *(ros.hear_kind(node, who, partial(self._on_kind, who)) for who in participants),
        ]

    @property
    def states(self) -> dict[str, State]:
        """The newest of each object, by id."""
        return {object_id: state for object_id, (state, _) in self._states.items()}

    @property
    def participation(self) -> Participation:
        """The participants by the kind that they have declared so far."""
        declared = {who: tuple(dict.fromkeys(kinds)) for who, kinds in self._declared.items()}
        return Participation(self._spec.mode, declared)

    @property
    def knows_bodies(self) -> bool:
        """Tell whether each object's process has said what keeps the object from being armed."""
        return all(object_id in self._bodies for object_id in self._targets)

    def facts(self) -> Facts:
        """Return the facts heard beside the states, and their ages; nothing of links."""
        now_s = time.monotonic()
        heard_s = {object_id: at_s for object_id, (_, at_s) in self._states.items()}
        ages_s = {who: now_s - at_s for who, at_s in {**heard_s, **self._sign_times_s}.items()}
        adapted = ages_s.get(names.VUT_ADAPTER, math.inf) <= ADAPTER_SILENT_S
        descriptions, at_s = self._strangers
        strangers = known_strangers(descriptions, now_s - at_s, self._rivals)
        return Facts(
            ages_s=ages_s,
            recorder_ready=self._recorder_ready,
            vut_refused=self._vut_refused if adapted else "",
            other_managers=len(strangers),
            foreign="; ".join(strangers),
            bodies=known_bodies(self._targets, self._bodies, seconds_to_ns(now_s)),
        )

    def close(self) -> None:
        """Stop hearing."""
        for one in self._subscriptions:
            self._node.destroy_subscription(one)
        self._subscriptions.clear()

    def _on_state(self, state: State) -> None:
        if state.object_id in self._ids:
            self._states[state.object_id] = (state, time.monotonic())

    def _on_array(self, array: StateArray) -> None:
        for state in array.states:
            self._on_state(state)

    def _on_recorder(self, message: RecorderStatus) -> None:
        self._recorder_ready = bool(message.ready)
        self._rivals = _short(message.strangers)
        self._sign_times_s[names.MONITOR] = time.monotonic()

    def _on_links(self, message: LinkStatus) -> None:
        self._strangers = _short(message.strangers), time.monotonic()

    def _on_camera(self, _: CameraInfo) -> None:
        self._sign_times_s[names.FRONT_CAMERA] = time.monotonic()

    def _on_body(self, message: BodyStatusMsg) -> None:
        status = body_status_of(message)
        if status.object_id in self._ids:
            self._bodies[status.object_id] = status, seconds_to_ns(time.monotonic())

    def _on_kind(self, who: str, kind: str) -> None:
        self._declared[who] = [*self._declared[who], kind[:MOST_TEXT]][:MOST_TOLD]

    def _on_localisation(self, message: LocalisationStatus) -> None:
        self._vut_refused = message.reason[:MOST_TEXT]
        self._sign_times_s[names.VUT_ADAPTER] = time.monotonic()


def _short(texts: Sequence[str]) -> list[str]:
    return [one[:MOST_TEXT] for one in texts[:MOST_TOLD]]
