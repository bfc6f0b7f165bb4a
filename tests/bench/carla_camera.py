"""Pictures of 1280 × 720 of the CARLA counterpart, one each tick and awaited, by SSP's connection
and by CARLA's bare client; and a whole session that it draws, beside one of our own renderer.

The counterpart draws flat boxes on this machine: nothing here is the time that CARLA renders.
"""

from __future__ import annotations

import json
import os
import queue
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from measure import report

ROOT = Path(__file__).parents[2]
SIZE, TICKS, ROUNDS = (1280, 720), 300, 3
BLUEPRINT = "vehicle.tesla.model3"


def ticks_a_second(tick: Callable[[float], None]) -> float:
    """Time ticks that move a body ahead, each to a place in m."""
    began_s = time.perf_counter()
    for index in range(TICKS):
        tick(15.0 + 0.01 * index)
    return TICKS / (time.perf_counter() - began_s)


def ours(address: str) -> float:
    """Ticks a second of SSP's connection."""
    from ssp_core.carla.address import parse_address
    from ssp_core.carla.client import CarlaServer
    from ssp_core.carla.frame import CarlaPose
    from ssp_core.carla.orders import Placement
    from ssp_core.carla.sensor import camera_attributes
    from ssp_core.run_file.model import Camera

    camera = Camera(width_px=SIZE[0], height_px=SIZE[1])
    with CarlaServer(parse_address(address, "address")) as server:
        server.take_over(0.05)
        (actor,) = server.spawn([("ot1", BLUEPRINT)])
        assert isinstance(actor, int)
        eye = server.start_camera(camera_attributes(camera), CarlaPose(0.0, 0.0, 1.5))

        def tick(x_m: float) -> None:
            server.picture(eye, server.step([Placement(actor, CarlaPose(x_m, 0.0, 0.0))]))

        return ticks_a_second(tick)


def bare(address: str) -> float:
    """Ticks a second of CARLA's client with the same commands and nothing besides."""
    import carla  # type: ignore[import-not-found,import-untyped,unused-ignore]

    host, _, port = address.rpartition(":")
    client = carla.Client(host, int(port))
    client.set_timeout(30.0)
    world = client.get_world()
    settings = world.get_settings()
    settings.synchronous_mode, settings.fixed_delta_seconds = True, 0.05
    world.apply_settings(settings)
    library = world.get_blueprint_library()
    actor = world.spawn_actor(library.find(BLUEPRINT), carla.Transform())
    blueprint = library.find("sensor.camera.rgb")
    for name, value in zip(("image_size_x", "image_size_y"), SIZE, strict=True):
        blueprint.set_attribute(name, str(value))
    eye = world.spawn_actor(blueprint, carla.Transform(carla.Location(0.0, 0.0, 1.5)))
    come: queue.Queue[Any] = queue.Queue()
    eye.listen(come.put)
    while True:
        frame = world.tick()
        try:
            while come.get(timeout=0.25).frame != frame:
                pass
            break
        except queue.Empty:
            continue

    def tick(x_m: float) -> None:
        place = carla.Transform(carla.Location(x_m, 0.0, 0.0))
        client.apply_batch_sync([carla.command.ApplyTransform(actor.id, place)], False)
        frame = world.tick()
        while come.get(timeout=30.0).frame != frame:
            pass

    return ticks_a_second(tick)


def rate(which: str) -> float:
    """Ticks a second, measured in a process of its own."""
    from tests.support.carla.counterpart import Counterpart

    with Counterpart() as server:
        return float(_output(__file__, which, server.address))


def session(task: Path, camera: str, out: Path) -> float:
    """Wall time of a session, s."""
    told = _output(
        "-m",
        "ssp_core.cli",
        "run",
        str(task),
        "--seed",
        "11",
        "--camera",
        camera,
        "--out",
        str(out),
        "--json",
    )
    return float(json.loads(told)["wall_s"])


def _output(*arguments: str) -> str:
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    done = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": path},
    )
    return done.stdout.splitlines()[-1]


def main() -> None:
    from ssp_scenario_manager.maps.site import LIBRARY
    from tests.support.carla.counterpart import Behaviour, Counterpart

    rates = {which: [rate(which) for _ in range(ROUNDS)] for which in ("ours", "bare")}
    report(
        "carla: ticks with a picture",
        statistics.median(rates["ours"]),
        statistics.median(rates["bare"]),
        "1/s",
        f"{SIZE[0]} x {SIZE[1]} px, {TICKS} ticks, median of {ROUNDS}; bound: CARLA's client alone",
        lower=False,
        ratio_limit=1.0 / 0.7,
    )
    chart = LIBRARY / "maps" / "bend.xodr"
    with tempfile.TemporaryDirectory() as folder:
        task = Path(folder) / "task"
        place = ("--map", str(chart), "--choose", "road 1 forward [0-312 m]", "--who", "bench")
        compiling = ("-m", "ssp_core.cli", "compile", "cut_in", "--target", "sumo")
        _output(*compiling, *place, "--out", str(task))
        walls: dict[str, list[float]] = {"carla": [], "raster": []}
        for index in range(ROUNDS):
            with Counterpart(Behaviour(xodr=chart.read_text())) as server:
                out = Path(folder) / f"carla_{index}"
                walls["carla"].append(session(task, f"carla://{server.address}", out))
            walls["raster"].append(session(task, "raster", Path(folder) / f"raster_{index}"))
    report(
        "carla: session",
        statistics.median(walls["carla"]),
        statistics.median(walls["raster"]),
        "s",
        f"wall time of cut_in, median of {ROUNDS}; bound: the same with our own renderer",
        lower=True,
        ratio_limit=1.6,
    )


if __name__ == "__main__":
    if len(sys.argv) == 3:
        print({"ours": ours, "bare": bare}[sys.argv[1]](sys.argv[2]))
    else:
        main()
