"""The catalogue of the CARLA counterpart: bodies with boxes, cameras, and their attributes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

INSTANCES = "sensor.camera.instance_segmentation"
_BOOL, _INT, _FLOAT, _STRING, _COLOUR = range(1, 6)


@dataclass(frozen=True)
class Body:
    """A blueprint with the box that an actor of it has, in m.

    Args:
        extent: half sizes.
        offset: of the box's middle from the actor's origin.
    """

    blueprint: str
    kind: str
    wheels: int
    extent: tuple[float, float, float]
    offset: tuple[float, float, float]
    generation: int = 1


BODIES = (
    Body("vehicle.tesla.model3", "car", 4, (2.40, 1.08, 0.75), (0.03, 0.0, 0.75)),
    Body("vehicle.mercedes.coupe_2020", "car", 4, (2.34, 0.905, 0.72), (0.0, 0.0, 0.72), 2),
    Body("vehicle.mini.cooper_s", "car", 4, (1.90, 0.98, 0.74), (0.02, 0.0, 0.74)),
    Body("vehicle.carlamotors.firetruck", "truck", 4, (4.23, 1.45, 1.91), (-0.25, 0.0, 1.91)),
    Body("vehicle.carlamotors.carlacola", "truck", 4, (2.60, 1.31, 1.23), (0.1, 0.0, 1.23)),
    Body("vehicle.mitsubishi.fusorosa", "bus", 4, (5.14, 1.97, 2.12), (-0.45, 0.12, 2.12)),
    Body("vehicle.kawasaki.ninja", "motorcycle", 2, (1.02, 0.40, 0.76), (0.0, 0.0, 0.76)),
    Body("vehicle.bh.crossbike", "bicycle", 2, (0.75, 0.43, 0.80), (0.0, 0.0, 0.80)),
    Body("vehicle.gazelle.omafiets", "bicycle", 2, (0.92, 0.33, 0.89), (0.0, 0.0, 0.89)),
    Body("walker.pedestrian.0001", "pedestrian", 0, (0.19, 0.19, 0.93), (0.0, 0.0, 0.0)),
    Body("walker.pedestrian.0002", "pedestrian", 0, (0.19, 0.19, 0.93), (0.0, 0.0, 0.0)),
)


def definitions() -> list[list[Any]]:
    """All blueprints as the wire has them."""

    def attribute(name: str, kind: int, value: str, changeable: bool = True) -> list[Any]:
        return [name, kind, value, [], changeable, False]

    found: list[list[Any]] = []
    for body in BODIES:
        if body.kind == "pedestrian":
            own = [
                attribute("role_name", _STRING, "pedestrian"),
                attribute("is_invincible", _BOOL, "true"),
                attribute("speed", _FLOAT, "1.4"),
            ]
        else:
            own = [
                attribute("number_of_wheels", _INT, str(body.wheels), False),
                attribute("base_type", _STRING, body.kind, False),
                attribute("generation", _INT, str(body.generation), False),
                attribute("color", _COLOUR, "17,37,103"),
                attribute("role_name", _STRING, "autopilot"),
            ]
        found.append([0, body.blueprint, body.blueprint.replace(".", ","), own])
    numbers = {
        "fov": "90.0",
        "sensor_tick": "0.0",
        "gamma": "2.2",
        "motion_blur_intensity": "0.45",
        "motion_blur_max_distortion": "0.35",
        "motion_blur_min_object_screen_size": "0.1",
        "lens_flare_intensity": "0.1",
        "bloom_intensity": "0.675",
        "fstop": "1.4",
        "iso": "100.0",
        "shutter_speed": "200.0",
        "exposure_min_bright": "10.0",
        "exposure_max_bright": "12.0",
        "exposure_speed_up": "3.0",
        "exposure_speed_down": "1.0",
        "exposure_compensation": "0.0",
        "lens_circle_falloff": "5.0",
        "lens_circle_multiplier": "0.0",
        "lens_k": "-1.0",
        "lens_kcube": "0.0",
        "chromatic_aberration_intensity": "0.0",
    }
    camera = [attribute(name, _FLOAT, value) for name, value in numbers.items()]
    camera += [
        attribute("image_size_x", _INT, "800"),
        attribute("image_size_y", _INT, "600"),
        attribute("enable_postprocess_effects", _BOOL, "true"),
        attribute("exposure_mode", _STRING, "histogram"),
        attribute("role_name", _STRING, "front"),
    ]
    found.append([0, "sensor.camera.rgb", "sensor,camera,rgb", camera])
    instances = [
        one
        for one in camera
        if one[0] in ("fov", "sensor_tick", "role_name") or one[0].startswith("image_size")
    ]
    found.append([0, INSTANCES, "sensor,camera,instance_segmentation", instances])
    # So that no picture of it passes for one of CARLA's.
    found.append([0, "static.prop.counterpart", "static,prop,counterpart", []])
    for uid, definition in enumerate(found, 1):
        definition[0] = uid
    return found
