"""Twenty ISO 22133 objects behind one gateway: what its process takes of a core, and how soon an
ObjectState follows the MONR that it is made of.

The objects are one process, the gateway is an ``object_target`` in a running session, and this
process plays manager and VUT. The lower bound is a process that sends datagrams of a MONR's size
back, 20 times 100 a second: its share of a core, and a round trip to it.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy

sys.path.insert(0, str(Path(__file__).parents[2]))

from measure import percentile, report
from page import share_over

from ssp_core import names, ros
from ssp_core.cdr.references import encode_reference
from ssp_core.cdr.states import decode_states, encode_state
from ssp_core.cdr.steps import Heartbeat, encode_heartbeat
from ssp_core.clock import seconds_to_ns
from ssp_core.host.children import die_with_parent
from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_core.motion.approach import approach_points
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState as State
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.object_rules import rules_of
from ssp_core.vocabulary import ControlState, Role, SessionPhase
from ssp_msgs import msg
from ssp_msgs.srv import ObjectCommand
from ssp_ot_controller.bodies.iso22133.units import QUARTER_MS_NS
from tests.support.processes.patience import WAITS
from tests.system.test_page import run_of_many

MEASURED_S = 10.0
SETTLE_S = 2.0
READY_TIMEOUT_S = 60.0
PERIOD_S = 0.01
# They drive for longer than all that is measured.
WAY_M, CRUISE_MPS = 40.0, 2.0
LEAD_S = 0.5
# Times what an echo of as many datagrams takes.
MOST_CPU = 40.0
MOST_P99 = 60.0
DATUM = {"latitude_deg": 57.7, "longitude_deg": 12.7, "altitude_m": 200.0, "yaw_rad": 0.0}
# Nobody has probed what stands in this file.
WAIVER = "waive=bench"
OBJECTS = Path(__file__).with_name("iso_objects.py")


def make_run() -> RunSpec:
    """Twenty objects that drive along x; a busy machine shows in the figures, and ends nothing."""
    given = run_of_many().model_dump(mode="json", by_alias=True, exclude_unset=True)
    # An object may go on for so long without hearing its commander, inside the fence.
    wide = {**dict.fromkeys(WAITS, 5.0), "duration_s": 600.0}
    given |= {"mode": "live", "domain": "physical", "step_s": PERIOD_S, "datum": DATUM}
    given["limits"] |= wide
    for target in given["targets"]:
        x_m, y_m = target["start"]["x_m"], target["start"]["y_m"]
        path = [(x_m, y_m), (x_m + WAY_M, y_m)]
        target["approach"] = {"path": path, "cruise_mps": CRUISE_MPS, "acceleration_mps2": 0.5}
    return RunSpec.model_validate(given)


class Helper:
    """A process of ``iso_objects.py``: its ports, and what it measured."""

    def __init__(self, *args: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(OBJECTS), *args],
            stdout=subprocess.PIPE,
            preexec_fn=die_with_parent,
        )
        self.ports = self._line()

    def end(self) -> Any:
        self.process.send_signal(signal.SIGTERM)
        return self._line()

    def _line(self) -> Any:
        assert self.process.stdout is not None
        return json.loads(self.process.stdout.readline())


class Around:
    """Manager and VUT around the gateway."""

    def __init__(self, run: RunSpec) -> None:
        self.node = rclpy.create_node("bench_iso", namespace=names.NAMESPACE)
        self.executor = ros.make_executor()
        self.executor.add_node(self.node)
        self.phase = SessionPhase.CONNECTED
        # Bytes of states with their arrivals; decoded when all is over.
        self.heard: list[tuple[int, bytes]] = []
        self._run = run
        self._sequence = 0
        pub, sub = self.node.create_publisher, self.node.create_subscription
        self._beat = pub(msg.Heartbeat, names.HEARTBEAT, ros.STATE)
        self._vut = pub(msg.ObjectState, names.state_topic(run.vut.id), ros.STATE)
        sub(msg.ObjectStates, names.OBJECT_STATES, self._on_states, ros.STATE, raw=True)
        self._references = {
            t.id: pub(msg.Reference, names.reference_topic(t.id), ros.COMMAND) for t in run.targets
        }
        self._clients = {
            t.id: self.node.create_client(ObjectCommand, names.command_service(t.id))
            for t in run.targets
        }
        self.node.create_timer(PERIOD_S, self._send)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()

    def spin(self, until: Callable[[], bool], what: str) -> None:
        """Spin until something holds; RuntimeError when it doesn't in time."""
        deadline = time.monotonic() + READY_TIMEOUT_S
        while not until():
            self.executor.spin_once(timeout_sec=0.1)
            if time.monotonic() > deadline:
                raise RuntimeError(f"timed out waiting until {what}")

    def spin_for(self, wait_s: float) -> None:
        until = time.monotonic() + wait_s
        self.spin(lambda: time.monotonic() >= until, "time has passed")

    def reach(self, state: ControlState) -> None:
        """Waits until all objects report a state, from now on."""
        self.heard.clear()
        wanted = {t.id for t in self._run.targets}

        def all_there() -> bool:
            newest = {s.object_id: s.control_state for _, d in self.heard[-20:] for s in states(d)}
            return {i for i, found in newest.items() if found is state} == wanted

        self.spin(all_there, f"all objects report {state.name}")

    def command(self, command: int) -> None:
        """Command every object; RuntimeError when one refuses."""
        version = self._run.event_version
        for object_id, client in self._clients.items():
            digest = rules_of(self._run, object_id).digest
            request = ObjectCommand.Request(
                command=command, event_version=version, rules_digest=digest
            )
            self.spin(client.service_is_ready, f"{object_id} takes commands")
            future = client.call_async(request)
            self.spin(future.done, f"{object_id} answers")
            if not future.result().accepted:
                raise RuntimeError(f"{object_id} refuses: {future.result().error_msg}")

    def dispatch(self) -> None:
        """Sends every object its approach."""
        for target in self._run.targets:
            now_ns, version = time.time_ns(), self._run.event_version
            at_ns = now_ns + seconds_to_ns(LEAD_S)
            points = approach_points(target.approach)
            reference = Reference(
                "approach", target.id, version, "approach", now_ns, at_ns, at_ns, points
            )
            self._references[target.id].publish(encode_reference(reference))

    def _on_states(self, data: bytes) -> None:
        self.heard.append((time.time_ns(), data))

    def _send(self) -> None:
        now_ns, vut = time.time_ns(), self._run.vut
        self._sequence += 1
        beat = Heartbeat(now_ns, "bench", self._sequence, now_ns, self.phase, {})
        self._beat.publish(encode_heartbeat(beat))
        pose = vut.start.pose
        state = State(
            vut.id,
            vut.cls,
            Role.VUT,
            now_ns,
            pose.x_m,
            pose.y_m,
            pose.yaw_rad,
            0.0,
            0.0,
            0.0,
            vut.size,
            sequence=self._sequence,
        )
        self._vut.publish(encode_state(state))


def states(data: bytes) -> tuple[State, ...]:
    return decode_states(data).states


def through_gateway(folder: Path) -> tuple[float, list[float], str]:
    """Share of a core, latencies in ms, and a note on rates."""
    run = make_run()
    run_file = folder / "run.yaml"
    run_file.write_text(run.model_dump_json(by_alias=True))
    with free_domain() as domain_id, (folder / "gateway.log").open("wb") as log:
        env = session_environment(domain_id)
        objects = Helper("objects", str(run_file))
        bodies = ",".join(
            f"{key}=iso22133://127.0.0.1:{port}?{WAIVER}" for key, port in objects.ports.items()
        )
        given = ["-p", f"run_file:={run_file}", "-p", f"bodies:={bodies}"]
        command = ["-m", "ssp_ot_controller.ros.object_target", "--ros-args", *given]
        gateway = subprocess.Popen(
            [sys.executable, *command], env=env, stdout=log, stderr=log, preexec_fn=die_with_parent
        )
        rclpy.init(domain_id=domain_id)
        around = Around(run)
        try:
            asked = ObjectCommand.Request
            around.reach(ControlState.DISARMED)
            around.command(asked.COMMAND_CONNECT)
            around.reach(ControlState.DISARMED)
            around.spin_for(SETTLE_S)
            around.command(asked.COMMAND_ARM)
            around.reach(ControlState.ARMED)
            around.phase = SessionPhase.ARMED
            around.spin_for(SETTLE_S)
            around.phase = SessionPhase.RUNNING
            around.reach(ControlState.RUNNING)
            around.dispatch()
            around.spin_for(SETTLE_S)
            around.heard.clear()
            share = measured(around, gateway.pid)
            heard = list(around.heard)
            around.reach(ControlState.RUNNING)
        except RuntimeError as error:
            raise RuntimeError(f"{error}\n{(folder / 'gateway.log').read_text()}") from None
        finally:
            around.close()
            rclpy.shutdown()
            gateway.terminate()
            gateway.wait(10.0)
        counts = objects.end()
    arrived = {
        (key, sent_ns - sent_ns % QUARTER_MS_NS): there_ns
        for key, (_, sent) in counts.items()
        for sent_ns, there_ns in sent
    }
    latencies: dict[tuple[str, int], float] = {}
    for at_ns, data in heard:
        for state in states(data):
            key = state.object_id, state.stamp_ns
            if key not in latencies:
                latencies[key] = (at_ns - arrived[key]) * 1e-6
    span_s = (heard[-1][0] - heard[0][0]) * 1e-9
    beats = sum(beats for beats, _ in counts.values())
    note = (
        f"{len(latencies) / span_s:.0f} states a second in {len(heard) / span_s:.0f} messages, "
        f"{beats / len(arrived):.2f} HEAB for each MONR"
    )
    return share, list(latencies.values()), note


def measured(around: Around, pid: int) -> float:
    """A process' share of a core while the session goes on."""
    found: list[float] = []
    thread = threading.Thread(target=lambda: found.append(share_over(pid, MEASURED_S)))
    thread.start()
    around.spin(lambda: not thread.is_alive(), "the time is over")
    return found[0]


def through_echo(count: int) -> tuple[float, list[float]]:
    """Share of a core, and round trips in ms."""
    echo = Helper("echo", str(count))
    ask = Helper("ask", *map(str, echo.ports))
    time.sleep(SETTLE_S)
    share = share_over(echo.process.pid, MEASURED_S)
    trips = [trip_ns * 1e-6 for trip_ns in ask.end()["trips_ns"]]
    echo.end()
    return share, trips


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        share, latencies, note = through_gateway(Path(folder))
    bound, trips = through_echo(len(make_run().targets))
    report(
        "iso: 20 objects, gateway",
        100.0 * share,
        100.0 * bound,
        "% of a core",
        note,
        lower=True,
        ratio_limit=MOST_CPU,
    )
    for name, part, limit in (("p50", 0.5, None), ("p99", 0.99, MOST_P99)):
        ours, theirs = percentile(latencies, part), percentile(trips, part)
        report(
            f"iso: MONR → state, {name}", ours, theirs, "ms", note, lower=True, ratio_limit=limit
        )


if __name__ == "__main__":
    main()
