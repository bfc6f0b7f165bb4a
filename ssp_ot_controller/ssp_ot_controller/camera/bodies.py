"""The body of an object: its class, extents, colours, lamps and pose of limbs and wheels."""

from __future__ import annotations

import zlib

from ssp_core.motion.state import ObjectState
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.camera import cars, heavy_vehicles, people, riders
from ssp_ot_controller.camera.indicators import OFF, Indicator, is_lit
from ssp_ot_controller.camera.mesh import Mesh
from ssp_ot_controller.camera.palettes import Palette, rgb
from ssp_ot_controller.camera.vehicle_parts import Lights

BRAKE_MPS2 = -0.5  # brake lamps shine below this acceleration
_BUS_PAINTS = (rgb("c9432f"), rgb("2f6fae"), rgb("e0b23c"))


def body(
    state: ObjectState, palette: Palette, travelled_m: float, indicator: Indicator = OFF
) -> Mesh:
    """The mesh of an object in its own frame; colours follow from its id.

    Args:
        state: gives class, extents, acceleration (brake lamps) and stamp (blinking).
        palette: colours, and whether lamps are on.
        travelled_m: way so far; turns wheels and moves limbs.
        indicator: which indicators blink.
    """
    number = zlib.crc32(state.object_id.encode())
    lit = is_lit(state.stamp_ns)
    lights = Lights(
        state.acceleration_mps2 < BRAKE_MPS2,
        palette.lamps_on,
        left=lit and indicator in (Indicator.LEFT, Indicator.BOTH),
        right=lit and indicator in (Indicator.RIGHT, Indicator.BOTH),
    )
    paint = palette.paints[number % len(palette.paints)]
    look = people.outfit(number, palette.clothes, palette.trousers)
    match state.object_class:
        case ObjectClass.TRUCK:
            return heavy_vehicles.truck(state.size, paint, lights, travelled_m)
        case ObjectClass.BUS:
            livery = _BUS_PAINTS[number % len(_BUS_PAINTS)]
            return heavy_vehicles.bus(state.size, livery, lights, travelled_m)
        case ObjectClass.MOTORCYCLE:
            return riders.motorcycle(state.size, look, lights, travelled_m)
        case ObjectClass.CYCLIST:
            return riders.cyclist(state.size, look, travelled_m, lights.lamps)
        case ObjectClass.PEDESTRIAN:
            return people.pedestrian(state.size, look, travelled_m, state.speed_mps)
        case _:
            return cars.car(state.size, paint, number // 16, lights, travelled_m)
