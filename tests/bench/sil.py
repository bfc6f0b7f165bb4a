"""A lockstep session through DDS against the same cores in one process without ROS."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from measure import report

from ssp_core.clock import ns_to_seconds
from ssp_core.reference import Reference
from ssp_core.run_spec import RunSpec
from ssp_core.vocab import SessionPhase
from ssp_ot_controller.core.bodies import Command
from ssp_ot_controller.core.object_machine import ObjectEvent
from ssp_ot_controller.sil.sumo_world import SumoWorld
from ssp_ot_controller.sil.world import World
from ssp_ot_controller.target.target import Target
from ssp_scenario_manager.core import outbox
from ssp_scenario_manager.core.readiness import Facts
from ssp_scenario_manager.core.session import Session
from ssp_scenario_manager.core.session_machine import SessionEvent
from ssp_scenario_manager.resolve import resolve_run
from ssp_scenario_manager.runner.session import run_session
from ssp_scenario_manager.scenario import load_scenario, load_site


def make_run() -> RunSpec:
    scenario, version = load_scenario("cut_in")
    site, site_version = load_site("boulevard")
    spec = resolve_run(
        scenario, version, site, site_version, run_id="bench", seed=1, mode="lockstep"
    )
    return spec.model_copy(update={"camera": None})


def without_ros(spec: RunSpec) -> tuple[float, float]:
    """Session seconds and wall seconds of the same run in one process."""
    with tempfile.TemporaryDirectory() as folder, SumoWorld(spec, Path(folder)) as sumo:
        world, session = World(spec, sumo), Session()
        targets = {t.id: Target(t.id, spec) for t in spec.targets}
        for target in targets.values():
            target.power_on()
        session.load(spec, 0)
        session.facts = Facts(True, (), 0.0, 0.0, 0.0, tuple((t, 0.0) for t in targets))
        commands: dict[str, tuple[int, Command]] = {}
        inbox: list[Reference] = []
        wishes = [SessionEvent.CONNECT, SessionEvent.ARM, SessionEvent.START]
        started = time.perf_counter()
        while session.state not in (SessionPhase.FINISHED, SessionPhase.ABORTED):
            now_ns = world.now_ns
            states = {s.object_id: s for s in world.objects()}
            for name, target in targets.items():
                target.on_session_state(session.state)
                for reference in [r for r in inbox if r.object_id == name]:
                    refusal = target.on_reference(reference, now_ns)
                    message = refusal.message if refusal else ""
                    session.on_ack(reference.reference_id, refusal is None, 0, message, now_ns)
                outcome = target.step(states[name], now_ns, 0.0)
                commands[name] = (world.step_index, outcome.command)
                session.on_target_state(outcome.report)
            inbox.clear()
            session.on_vut_state(states["vut"])
            if wishes and session.command(wishes[0], now_ns, "bench", "").accepted:
                wishes.pop(0)
            session.step(now_ns)
            for fact in session.outbox:
                if isinstance(fact, outbox.Dispatch):
                    inbox.append(fact.reference)
                elif isinstance(fact, outbox.ArmObjects):
                    for target in targets.values():
                        target.command(ObjectEvent.ARM, spec.event_version, 0.0)
            session.outbox.clear()
            if session.state in (SessionPhase.LOADED, SessionPhase.CONNECTED, SessionPhase.ARMED):
                continue
            world.advance(commands, session.state is SessionPhase.RUNNING)
        if session.state is not SessionPhase.FINISHED:
            raise RuntimeError(f"the run without ROS failed: {session.reasons}")
        return ns_to_seconds(world.now_ns), time.perf_counter() - started


def main() -> None:
    spec = make_run()
    with tempfile.TemporaryDirectory() as folder:
        result = run_session(spec, Path(folder), lambda line: None)
    if not result.outcome.ok:
        raise RuntimeError(f"the session failed: {result.outcome.reasons}")
    simulated, wall = without_ros(spec)
    report(
        "SIL: lockstep through DDS",
        result.session_s / result.running_wall_s,
        simulated / wall,
        "x real time",
        f"{len(spec.targets)} object target(s), {1 / spec.step_s:.0f} Hz, camera off",
        lower=False,
    )


if __name__ == "__main__":
    main()
