"""Pictures of a moving body, taken by SSP's connection in a process of its own.

``python -m tests.support.carla.driver HOST:PORT FRAMES`` prints JSON: how many pictures came,
and those that hold another frame or pose than the tick's.
"""

from __future__ import annotations

import json
import math
import sys

from ssp_core.carla.address import parse_address
from ssp_core.carla.client import CarlaServer
from ssp_core.carla.frame import CarlaPose
from ssp_core.carla.orders import Placement
from ssp_core.carla.sensor import camera_attributes
from ssp_core.run_file.model import Camera
from tests.support.carla.picture import read_picture

# Longer than a picture takes on a busy machine, where none is lost.
WAIT_S = 0.3


def main(address: str, frames: int) -> None:
    camera = Camera(width_px=320, height_px=64)
    came, wrong = 0, []
    with CarlaServer(parse_address(address, "address")) as server:
        server.take_over(0.05)
        (actor,) = server.spawn([("ot1", "vehicle.tesla.model3")])
        assert isinstance(actor, int)
        eye = server.start_camera(camera_attributes(camera), CarlaPose(0.0, 0.0, 1.5))
        for index in range(frames):
            wanted = CarlaPose(15.0 + 0.01 * index, math.sin(index), 0.0, 0.0, float(index % 90))
            frame = server.step([Placement(actor, wanted)])
            picture = eye.take(frame, WAIT_S)
            if picture is None:
                continue
            came += 1
            told = read_picture(picture.pixels)
            x, y, yaw = told.poses[actor]
            off = max(abs(x - wanted.x_m), abs(y - wanted.y_m), abs(yaw - wanted.yaw_deg))
            if told.frame != frame or off > 0.011:
                wrong.append((frame, told.frame, off))
    print(json.dumps({"came": came, "wrong": wrong}))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
