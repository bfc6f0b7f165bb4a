"""What an object class of ours is in OpenSCENARIO and in CARLA."""

from __future__ import annotations

from dataclasses import dataclass

from scenariogeneration import xosc  # type: ignore[import-untyped]  # it ships no types

from ssp_core.vocabulary import ObjectWord


@dataclass(frozen=True, slots=True)
class ClassFacts:
    """One object class elsewhere.

    Args:
        blueprint: of CARLA 0.9.16; ScenarioRunner takes it from the entity's name or model.
        category: OpenSCENARIO's vehicle category; None for a pedestrian.
        wheelbase_m: front axle ahead of the reference point, which is below the rear axle.
        track_m: between the wheels of an axle.
        wheel_m: wheel diameter.
        steering_rad: largest steering angle.
        speed_mps: highest speed that the body can drive.
        acceleration_mps2: highest acceleration of the body.
        deceleration_mps2: highest deceleration of the body.
        mass_kg: of a pedestrian.
    """

    blueprint: str
    category: xosc.VehicleCategory | None
    wheelbase_m: float
    track_m: float
    wheel_m: float
    steering_rad: float
    speed_mps: float
    acceleration_mps2: float
    deceleration_mps2: float
    mass_kg: float


# CARLA's bodies nearest in size to ours (ssp_core.motion.state.DEFAULT_SIZES). The speeds and
# accelerations bound what a player may do with the body and lie above what a task asks of it.
CLASSES: dict[ObjectWord, ClassFacts] = {
    "car": ClassFacts(
        "vehicle.tesla.model3",
        xosc.VehicleCategory.car,
        wheelbase_m=2.7,
        track_m=1.6,
        wheel_m=0.65,
        steering_rad=0.6,
        speed_mps=60.0,
        acceleration_mps2=10.0,
        deceleration_mps2=10.0,
        mass_kg=1700.0,
    ),
    "truck": ClassFacts(
        "vehicle.carlamotors.firetruck",
        xosc.VehicleCategory.truck,
        wheelbase_m=5.2,
        track_m=2.1,
        wheel_m=1.0,
        steering_rad=0.6,
        speed_mps=30.0,
        acceleration_mps2=5.0,
        deceleration_mps2=8.0,
        mass_kg=12000.0,
    ),
    "bus": ClassFacts(
        "vehicle.mitsubishi.fusorosa",
        xosc.VehicleCategory.bus,
        wheelbase_m=6.0,
        track_m=2.1,
        wheel_m=1.0,
        steering_rad=0.7,
        speed_mps=30.0,
        acceleration_mps2=5.0,
        deceleration_mps2=8.0,
        mass_kg=11000.0,
    ),
    "motorcycle": ClassFacts(
        "vehicle.kawasaki.ninja",
        xosc.VehicleCategory.motorbike,
        wheelbase_m=1.4,
        track_m=0.01,
        wheel_m=0.6,
        steering_rad=0.5,
        speed_mps=60.0,
        acceleration_mps2=10.0,
        deceleration_mps2=10.0,
        mass_kg=220.0,
    ),
    "cyclist": ClassFacts(
        "vehicle.bh.crossbike",
        xosc.VehicleCategory.bicycle,
        wheelbase_m=1.0,
        track_m=0.01,
        wheel_m=0.7,
        steering_rad=0.7,
        speed_mps=15.0,
        acceleration_mps2=4.0,
        deceleration_mps2=6.0,
        mass_kg=90.0,
    ),
    "pedestrian": ClassFacts(
        "walker.pedestrian.0001",
        None,
        wheelbase_m=0.0,
        track_m=0.0,
        wheel_m=0.0,
        steering_rad=0.0,
        speed_mps=6.0,
        acceleration_mps2=5.0,
        deceleration_mps2=5.0,
        mass_kg=75.0,
    ),
}
