"""A recording of a small simulated world, with frames as the front camera draws them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.types import serialize
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.states import encode_state
from ssp_core.cdr.steps import WorldTick, encode_tick
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.transforms import encode_transforms, of_state
from ssp_ot_controller.camera.frames import Odometer, jpeg
from ssp_ot_controller.camera.renderer.render import render
from ssp_ot_controller.camera.renderer.scene import Indicators, Scene
from tests.support.bags.messages import header, message, picture
from tests.support.runs import cut_in_run
from tests.support.states import object_state

STEP_NS = 20_000_000
STEPS_PER_FRAME = 10
HELD = 2
TICK, IMAGE = "/ssp/world/tick", "/ssp/vut/front_camera/image/compressed"
CAMERA = {"width_px": 192, "height_px": 108, "rate_hz": 5.0}


def cutting_in(step: int) -> tuple[ObjectState, ...]:
    """The VUT at 10 m/s; ot1, 15 m ahead on its left, changes lanes from 1 s on and then brakes;
    a lorry stands far ahead, and a pedestrian of the world's traffic walks beside the road.
    """
    t_s = step * STEP_NS / 1e9
    side = min(1.0, max(0.0, (t_s - 1.0) / 1.5))
    turning = 0.0 < side < 1.0
    car = object_state(
        "ot1",
        x_m=15.0 + 9.0 * t_s,
        y_m=3.5 * (1.0 - side),
        yaw_rad=-math.atan2(3.5 / 1.5, 9.0) if turning else 0.0,
        speed_mps=9.0,
        acceleration_mps2=-2.0 if side == 1.0 else 0.0,
    )
    found = (
        car,
        object_state("ot2", ObjectClass.TRUCK, x_m=70.0, y_m=3.5),
        object_state(
            "passer",
            ObjectClass.PEDESTRIAN,
            x_m=30.0,
            y_m=-4.0 + t_s,
            yaw_rad=1.57,
            speed_mps=1.0,
            role=Role.TRAFFIC,
        ),
        object_state("vut", x_m=10.0 * t_s, speed_mps=10.0),
    )
    return tuple(replace(state, stamp_ns=step * STEP_NS, sequence=step + 1) for state in found)


def small_world(**changes: Any) -> RunSpec:
    """The run that ``record_world`` records; keywords replace its parts."""
    made = cut_in_run()
    start = {"x_m": 70.0, "y_m": 3.5, "yaw_rad": 0.0}
    made["targets"].append({"id": "ot2", "object_class": "truck", "start": start})
    return RunSpec.model_validate({**made, "camera": CAMERA, **changes})


def record_world(
    folder: Path,
    *,
    steps: int = 150,
    run: RunSpec | None = None,
    states: Callable[[int], tuple[ObjectState, ...]] = cutting_in,
    frame: Callable[[bytes], bytes] = lambda data: data,
) -> Path:
    """A run's folder with its bag: ticks, reported states, /tf, frames, session states, run file.

    Args:
        run: with a camera whose frames are ten steps apart.
        states: true states of a step, in the order of the ids.
        frame: what becomes of a frame's JPEG before it is recorded.
    """
    run = run or small_world()
    if run.camera is None:
        raise ValueError("the run has no camera")
    odometer, indicators = Odometer(), Indicators(run.road)
    reported = [run.vut.id, *(target.id for target in run.targets)]
    with BagWriter(folder / "bag") as writer:
        writer.attach("run.yaml", run.model_dump_json(by_alias=True).encode(), "application/yaml")
        writer.attach("recording.json", b"{}\n", "application/json")
        writer.add_topic("/ssp/session_state", "ssp_msgs/msg/SessionState", offered_qos(5))
        writer.add_topic(TICK, "ssp_msgs/msg/WorldTick", offered_qos(50))
        writer.add_topic("/tf", "tf2_msgs/msg/TFMessage", offered_qos(50))
        writer.add_topic(IMAGE, "sensor_msgs/msg/CompressedImage", offered_qos(20))
        for name in reported:
            writer.add_topic(f"/ssp/{name}/state", "ssp_msgs/msg/ObjectState", offered_qos(50))
        _session(writer, run, 5, 0, 0)
        # The world holds at its first step for a while, which has a frame each time.
        for count, step in enumerate([*[0] * HELD, *range(steps)]):
            at_ns, present = step * STEP_NS, states(step)
            odometer.update(present)
            tick = WorldTick(at_ns, step, count >= HELD, True, count, count, present)
            writer.write(TICK, encode_tick(tick), at_ns, at_ns, count)
            sending = [state for state in present if state.object_id in reported]
            for state in sending:
                data = encode_state(state)
                writer.write(f"/ssp/{state.object_id}/state", data, at_ns, at_ns, count)
            writer.write("/tf", encode_transforms(map(of_state, sending)), at_ns, at_ns, count)
            if step % STEPS_PER_FRAME:
                continue
            vut = next(state for state in present if state.object_id == run.vut.id)
            blinking = indicators.update(present, at_ns)
            scene = Scene(run.road, vut, present, odometer.snapshot(), blinking)
            pixels = render(scene, run.look, run.camera, step // STEPS_PER_FRAME, run.seed)
            taken = picture(frame(jpeg(pixels, run.camera.jpeg_quality)), at_ns)
            writer.write(IMAGE, taken, at_ns, at_ns, count)
        _session(writer, run, 7, 1, steps * STEP_NS)
    verdict = {"schema": "ssp.verdict/1", "verdict": "valid", "reasons": [], "told_by": "runner"}
    (folder / "bag" / "verdict.json").write_text(json.dumps(verdict))
    return folder


def _session(writer: BagWriter, run: RunSpec, state: int, verdict: int, at_ns: int) -> None:
    told = message(
        "ssp_msgs/msg/SessionState",
        header=header(at_ns),
        state=state,
        previous=0,
        event="test",
        reason="",
        run_id=run.run_id,
        scenario=run.scenario,
        event_version=run.event_version,
        verdict=verdict,
        reasons=[],
    )
    writer.write("/ssp/session_state", serialize(told), at_ns, at_ns)
