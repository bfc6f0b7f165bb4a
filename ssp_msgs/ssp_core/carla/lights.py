"""The traffic lights of a CARLA world: green and stopped while a client uses it, then as before."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

_TYPE = "traffic.traffic_light*"


@dataclass(frozen=True, slots=True)
class Lights:
    """The traffic lights of a world that has had a frame.

    Args:
        states: numbers of carla.TrafficLightState, by actor.
        stopped: the clocks of all of them stand.
    """

    states: Mapping[int, int]
    stopped: bool

    @classmethod
    def of_world(cls, world: Any) -> Lights:
        """Read the lights of a carla.World."""
        lights = list(world.get_actors().filter(_TYPE))
        states = {int(one.id): int(one.get_state()) for one in lights}
        return cls(states, all(one.is_frozen() for one in lights))

    @classmethod
    def of_values(cls, values: Mapping[str, Any]) -> Lights:
        """Read what ``values`` gave, from JSON; raise ValueError, KeyError or TypeError."""
        states = {int(actor): int(state) for actor, state in values["states"].items()}
        return cls(states, bool(values["stopped"]))

    @property
    def values(self) -> dict[str, Any]:
        """Return the fields for JSON."""
        return asdict(self)

    def turn_green(self, carla: Any, world: Any) -> None:
        """Ask for green lights whose clocks stand; a frame shows it some ticks later."""
        world.freeze_all_traffic_lights(True)
        for one in world.get_actors(list(self.states)):
            one.set_state(carla.TrafficLightState.Green)

    def others_than_green(self, carla: Any, world: Any) -> int:
        """Count the lights that aren't green in the newest frame."""
        green = carla.TrafficLightState.Green
        return sum(one.get_state() != green for one in world.get_actors(list(self.states)))

    def give_back(self, carla: Any, world: Any) -> None:
        """Ask for the lights as they were."""
        for one in world.get_actors(list(self.states)):
            one.set_state(carla.TrafficLightState.values[self.states[int(one.id)]])
        if not self.stopped:
            world.freeze_all_traffic_lights(False)
