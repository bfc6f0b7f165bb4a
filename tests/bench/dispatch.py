"""Trigger to dispatch under load, beside bare rclpy nodes that answer on the same topics.

The scenario_manager runs in a process of its own; in the next round a bare node takes its place and
hears the same messages. What is measured is the time from publishing the state that decides to
receiving the reference that it causes, so that the middleware, the executor and whatever else the
process does count.

Two bare nodes: one that hears messages as rclpy gives them, and one that is given bytes and only
counts them. Both send references that were made beforehand. The limits hold beside the first; the
second is the least that the middleware and the executor take, for a node that knows nothing of what
it has heard. Rounds alternate, and a percentile is that of the best round on either side: a stall
of the machine in one round says nothing about the node.
"""

from __future__ import annotations

import gc
import os
import struct
import sys
import tempfile
from pathlib import Path

import rclpy
import rclpy.experimental
from measure import LONG, percentile, report
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from track import (
    FIRST_TRIGGER_S,
    PERIOD_S,
    TARGETS,
    TRIGGER_SPACING_S,
    TRIGGERS,
    Heard,
    Track,
    crossing,
    make_run,
    play,
    start_session,
    take_last_counts,
    wait_for,
)

from ssp_core import names, ros
from ssp_core.cdr.references import encode_reference
from ssp_core.files.writing import write_text
from ssp_core.geometry import Polyline
from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_core.host.processes import ProcessGroup
from ssp_core.motion.manoeuvre import drive_along
from ssp_core.motion.reference import Reference
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import Motion
from ssp_msgs import msg
from ssp_scenario_manager.run.over_dds.session import PROFILE

HERE = Path(__file__).parent
ROUNDS = 5 if LONG else 3
PLAYED_S = FIRST_TRIGGER_S + TRIGGERS * TRIGGER_SPACING_S + 1.2
EVERY = round(TRIGGER_SPACING_S / PERIOD_S)
MANAGER, TYPED, BYTES = "manager", "bare node", "bare node on bytes"
LIMITS = {0.5: 1.3, 0.99: 1.5}


class Echo(Node):
    """The bare node: hears what the manager hears, and answers every fifth VUT state.

    Parameter ``raw``: what it hears stays bytes.
    """

    def __init__(self, stop: ros.StopRequest) -> None:
        super().__init__("bench_echo", namespace=names.NAMESPACE)
        self._raw = self.declare_parameter("raw", False).value
        ids = [f"ot{k + 1}" for k in range(TARGETS)]
        self._publishers = [
            self.create_publisher(msg.Reference, names.reference_topic(i), ros.COMMAND) for i in ids
        ]
        self._answers = [bytearray(encode_reference(self._reference(i))) for i in ids]
        self._count = 0
        heard = [
            (msg.WorldTick, names.WORLD_TICK, ros.STATE),
            (msg.ObjectStates, names.OBJECT_STATES, ros.STATE),
            *((msg.ReferenceAck, names.ack_topic(i), ros.COMMAND) for i in ids),
        ]
        for kind, topic, qos in heard:
            self.create_subscription(kind, topic, lambda message: None, qos, raw=self._raw)
        vut_topic = names.state_topic(names.VUT_ID)
        on_vut = self._on_vut_bytes if self._raw else self._on_vut
        self.create_subscription(msg.ObjectState, vut_topic, on_vut, ros.STATE, raw=self._raw)

    @staticmethod
    def _reference(object_id: str) -> Reference:
        """Make a reference as long as those of the manager."""
        motion = Motion(path=crossing(0), cruise_mps=1.5)
        speeds = motion.cruise_mps, motion.acceleration_mps2, motion.deceleration_mps2
        points = drive_along(Polyline(motion.path), 0.0, 0.0, *speeds)
        version = "sha256:" + 64 * "0"
        return Reference("t1-ot1-1", object_id, version, "manoeuvre", 0, 0, 0, points)

    def _answer(self, stamp: bytes) -> None:
        """Answers every fifth state, with the stamp that it had."""
        self._count += 1
        if self._count % EVERY:
            return
        k = self._count // EVERY % TARGETS
        answer = self._answers[k]
        answer[4:12] = stamp
        self._publishers[k].publish(bytes(answer))

    def _on_vut(self, message: msg.ObjectState) -> None:
        stamp = message.header.stamp
        self._answer(struct.pack("<iI", stamp.sec, stamp.nanosec))

    def _on_vut_bytes(self, data: bytes) -> None:
        self._answer(data[4:12])


def measure(spec: RunSpec, run_file: Path, who: str) -> Heard:
    """One round: what came back from the manager or from a bare node in its place."""
    with free_domain() as domain_id, tempfile.TemporaryDirectory() as folder:
        context = rclpy.Context()
        rclpy.init(
            context=context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO
        )
        env = session_environment(domain_id, PROFILE)
        # The bare node is a module of this folder, where a node isn't looked for.
        env["PYTHONPATH"] = os.pathsep.join(filter(None, (str(HERE), env.get("PYTHONPATH"))))
        try:
            with ProcessGroup(env, Path(folder)) as group:
                track = Track(spec, context)
                executor = rclpy.experimental.EventsExecutor(context=context)
                executor.add_node(track)
                if who == MANAGER:
                    group.start_node(
                        names.SCENARIO_MANAGER, "ssp_scenario_manager.ros.manager_node", {}
                    )
                    start_session(track, executor, str(run_file))
                else:
                    group.start_node("bench_echo", "dispatch", {"raw": who == BYTES})
                    vut_topic = names.state_topic(names.VUT_ID)
                    there = lambda: track.count_subscribers(vut_topic) > 0  # noqa: E731
                    wait_for(track, executor, there, "the bare node is there")
                gc.collect()
                gc.disable()  # of this process, which is not what is measured
                play(track, executor, PLAYED_S)
                gc.enable()
                if who == MANAGER:
                    take_last_counts(track, executor)
                executor.shutdown()
                track.destroy_node()
                return track.heard
        finally:
            rclpy.shutdown(context=context)


def least(rounds: list[list[float]], share: float) -> float:
    """The least over the rounds of the value below which that share of a round lies."""
    return min(percentile(one, share) for one in rounds)


def main() -> None:
    spec = make_run()
    bounds = (TYPED, BYTES) if LONG else (TYPED,)
    rounds: dict[str, list[Heard]] = {who: [] for who in (MANAGER, *bounds)}
    with tempfile.TemporaryDirectory() as folder:
        run_file = Path(folder) / "run.yaml"
        write_text(run_file, spec.model_dump_json(by_alias=True))
        for _ in range(ROUNDS):
            for who, heard in rounds.items():
                heard.append(measure(spec, run_file, who))
    latencies = {who: [one.latencies_ms for one in heard] for who, heard in rounds.items()}
    for who in bounds:
        for share, limit in LIMITS.items():
            report(
                f"dispatch: p{share * 100:.0f} beside a {who}",
                least(latencies[MANAGER], share),
                least(latencies[who], share),
                "ms",
                f"{TARGETS + 1} objects at {1 / PERIOD_S:.0f} Hz, "
                f"best of {ROUNDS} rounds of {len(latencies[MANAGER][0])} triggers",
                lower=True,
                ratio_limit=limit if who == TYPED else None,
            )
    report(
        "dispatch: oldest state that was answered",
        max(map(max, latencies[MANAGER])),
        max(map(max, latencies[TYPED])),
        "ms",
        f"{sum(one.records for one in rounds[MANAGER])} decision records",
        lower=True,
        limit=2.0 * PERIOD_S * 1e3,
    )
    sent, received, lost = (
        sum(getattr(one, count) for one in rounds[MANAGER])
        for count in ("sent", "received", "lost")
    )
    report(
        "dispatch: states lost unnoticed",
        float(max(0, sent - received - lost)),
        None,
        "states",
        f"at least {sent} sent, {received} received by the manager, {lost} reported as lost",
        lower=True,
        limit=0.0,
    )


if __name__ == "__main__":
    if "--ros-args" in sys.argv:
        sys.exit(ros.run_node(Echo, lambda node: None))
    main()
