"""The connection to a CARLA server: the one place that imports CARLA's client.

A server keeps what a client left in it, and a client that lost its server never finds it again.
So the first error of a call ends a connection, nothing is ticked after it, and ``close`` puts the
settings back and destroys what was spawned, where the server still answers.
"""

from __future__ import annotations

import importlib
import math
import socket
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Any

from ssp_core.carla.acceptance import (
    ServerFacts,
    foreign_actors,
    opendrive_sha256,
    refusals,
    version_refusal,
)
from ssp_core.carla.address import CarlaAddress
from ssp_core.carla.blueprints import PEDESTRIAN_PREFIX, VEHICLE_PREFIX, Blueprint
from ssp_core.carla.frame import BodyBox, CarlaPose, Ground
from ssp_core.carla.left import LeftFile, forget_left, read_left
from ssp_core.carla.lights import Lights
from ssp_core.carla.orders import CarlaMotion, PedalOrder, Placement, transform_of
from ssp_core.carla.pictures import CarlaCamera, Picture, pose_of_transform
from ssp_core.carla.record import COUNTERPART_BLUEPRINT
from ssp_core.carla.sensor import CAMERA_BLUEPRINT
from ssp_core.errors import HostError, PeerError

# The answer to a call; a session's limit for a silent camera is above it.
TIMEOUT_S = 8.0
_RESTORE_S = 2.0
_CONNECT_S = 3.0
# While a synchronous server is watched for the tick of another client.
_WATCH_S = 1.0
# Actors appear high above the ground and apart, where nothing is that they could hit.
_HIGH_M, _APART_M, _IN_A_ROW = 300.0, 25.0, 10
_WARM_UP_TICKS, _WARM_UP_WAIT_S = 40, 0.25
_SETTLE_TICKS = 10
# A state is read back as it was set, up to the server's float32 on a large map.
_PLACE_M, _YAW_DEG = 0.01, 0.05
# CARLA takes at most max_substeps of max_substep_delta_time for a step.
_SUBSTEP_S, _MOST_SUBSTEPS = 0.01, 16
NEWEST_PYTHON = (3, 12)


def client_library() -> Any:
    """Import CARLA's client.

    Raises:
        HostError: it isn't installed.
    """
    try:
        return importlib.import_module("carla")
    except ImportError as error:
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        newest = f"{NEWEST_PYTHON[0]}.{NEWEST_PYTHON[1]}"
        remedy = (
            "install the extra: .venv/bin/uv pip install carla==0.9.16"
            if sys.version_info[:2] <= NEWEST_PYTHON
            else f"it has no wheel for Python {version}; make the environment with {newest} "
            f"(SSP_PYTHON=python{newest})"
        )
        raise HostError(f"CARLA's client can't be imported: {error}; {remedy}") from error


class CarlaServer:
    """A server that answers, and of the client's own version.

    Raises:
        HostError: CARLA's client isn't installed.
        PeerError: no server answers, or a server of another version does. Every method raises it
            for a server that doesn't answer, refuses, or has lost an actor.
    """

    def __init__(self, address: CarlaAddress, timeout_s: float = TIMEOUT_S) -> None:
        self._carla = client_library()
        self.address, self._timeout_s = address, timeout_s
        self._lost = False
        self._settings: Any = None
        self._weather: Any = None
        self._lights: Lights | None = None
        self._spawned: list[int] = []
        self._roles: dict[int, str] = {}
        self._sensors: list[Any] = []
        self._left = LeftFile(address)
        # CARLA's client tells a closed port from a busy server by waiting for the whole limit.
        try:
            socket.create_connection((address.host, address.port), _CONNECT_S).close()
        except OSError as error:
            raise PeerError(
                f"no CARLA server at {address}: {error.strerror or error}; start one, or name its "
                "RPC port"
            ) from error
        with self._asking("asked for its version"):
            self._client = self._carla.Client(address.host, address.port)
            self._client.set_timeout(timeout_s)
            self.version = str(self._client.get_server_version())
        self.client_version = str(self._client.get_client_version())
        # Before anything else: a client crashes on messages of another version.
        refusal = version_refusal(self.version, self.client_version)
        if refusal is not None:
            raise PeerError(f"{refusal.text}; {refusal.remedy}")
        with self._asking("asked for its world"):
            self._world = self._client.get_world()

    def __enter__(self) -> CarlaServer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @contextmanager
    def _asking(self, what: str) -> Iterator[None]:
        """Turn an error of CARLA's client into one message, and take the server for lost."""
        try:
            yield
        except RuntimeError as error:
            self._lost = True
            text = str(error).strip().splitlines()[0] if str(error).strip() else "no reason given"
            if "time-out" in text:
                text = (
                    f"no answer within {self._timeout_s:g} s; is it running, is this its RPC port, "
                    "and does a firewall let it and the next port through?"
                )
            raise PeerError(f"CARLA server {self.address}, {what}: {text}") from error

    # -- what it says -----------------------------------------------------------------------------

    def restore_left(self) -> str:
        """Give back what a client of this machine that was killed left; in words, or empty.

        Nothing is changed in a server that isn't synchronous any more, or that somebody ticks.
        """
        left = read_left(self.address)
        if left is None:
            return ""
        with self._asking("asked for its settings"):
            settings = self._world.get_settings()
        if not settings.synchronous_mode:
            forget_left(self.address)
            return ""
        with suppress(RuntimeError):
            self._world.wait_for_tick(_WATCH_S)
            return ""  # somebody ticks it
        with self._asking("given back what a client that is gone left in it"):
            _set_fields(settings, left.settings)
            self._world.apply_settings(settings, self._timeout_s)
            # Without a tick the client knows no actors.
            if not settings.synchronous_mode:
                self._world.wait_for_tick(self._timeout_s)
            left_actors = [one for one in self._world.get_actors() if int(one.id) in left.actors]
            theirs = [int(one.id) for one in left_actors if foreign_actors([str(one.type_id)])]
            destroy = [self._carla.command.DestroyActor(actor) for actor in theirs]
            if destroy:
                self._client.apply_batch_sync(destroy, False)
            if left.lights is not None:
                left.lights.give_back(self._carla, self._world)
            _set_fields(weather := self._world.get_weather(), left.weather)
            self._world.set_weather(weather)
            for _ in range(_SETTLE_TICKS):
                if _numbers(self._world.get_weather()) == left.weather:
                    break
                self._world.wait_for_tick(self._timeout_s)
        forget_left(self.address)
        return (
            f"CARLA server {self.address}: a client that was killed had left {len(theirs)} actors "
            "and its settings; they were given back"
        )

    def facts(self) -> ServerFacts:
        """Ask for everything that decides whether a run is accepted, and change nothing."""
        with self._asking("asked for its settings and map"):
            synchronous = bool(self._world.get_settings().synchronous_mode)
            chart = self._world.get_map()
        ticking = False
        # Without a tick the client knows no actors.
        with suppress(RuntimeError):
            self._world.wait_for_tick(_WATCH_S if synchronous else self._timeout_s)
            ticking = True
        with self._asking("asked for its actors"):
            actors = tuple(str(actor.type_id) for actor in self._world.get_actors())
        return ServerFacts(
            version=self.version,
            client_version=self.client_version,
            map_name=str(chart.name),
            map_sha256=opendrive_sha256(str(chart.to_opendrive())),
            synchronous=synchronous,
            ticking=synchronous and ticking,
            actors=actors,
        )

    def accept(self, map_sha256: str) -> ServerFacts:
        """Give back what a killed client left, and ask whether a run is accepted.

        Raises:
            PeerError: it isn't.
        """
        self.restore_left()
        facts = self.facts()
        if refused := refusals(facts, map_sha256):
            raise PeerError(
                f"CARLA server {self.address} is refused: "
                + "; ".join(f"{one.text}; {one.remedy}" for one in refused)
            )
        return facts

    def settings(self) -> dict[str, Any]:
        """Return the world's settings by the names of carla.WorldSettings."""
        with self._asking("asked for its settings"):
            return _fields(self._world.get_settings())

    def weather(self) -> dict[str, float]:
        """Return the weather as the server has it, by the names of carla.WeatherParameters."""
        with self._asking("asked for its weather"):
            return _numbers(self._world.get_weather())

    def blueprints(self) -> list[Blueprint]:
        """List all vehicles and pedestrians that it offers, by id."""
        with self._asking("asked for its blueprints"):
            library = list(self._world.get_blueprint_library())
        body_blueprints = []
        for one in library:
            if not one.id.startswith((VEHICLE_PREFIX, PEDESTRIAN_PREFIX)):
                continue
            has_base, has_wheels = map(one.has_attribute, ("base_type", "number_of_wheels"))
            base = one.get_attribute("base_type").as_str() if has_base else ""
            wheels = one.get_attribute("number_of_wheels").as_int() if has_wheels else 0
            body_blueprints.append(Blueprint(str(one.id), base, wheels))
        return sorted(body_blueprints, key=lambda one: one.id)

    def is_counterpart(self) -> bool:
        """Tell whether the server says that it stands in for CARLA in tests."""
        with self._asking("asked for its blueprints"):
            library = self._world.get_blueprint_library()
            return any(one.id == COUNTERPART_BLUEPRINT for one in library)

    def ground(self) -> Ground:
        """Return the height of the map's roads and sidewalks at x, y of frame map."""
        with self._asking("asked for its map"):
            chart = self._world.get_map()
        every, locate = self._carla.LaneType.Any, self._carla.Location

        def height(x_m: float, y_m: float) -> float:
            waypoint = chart.get_waypoint(locate(x_m, -y_m, 0.0), True, every)
            return 0.0 if waypoint is None else float(waypoint.transform.location.z)

        return height

    def set_timeout(self, timeout_s: float) -> None:
        """Wait no longer than this for each answer from here on."""
        self._timeout_s = timeout_s
        self._client.set_timeout(timeout_s)

    def start_place(self) -> CarlaPose:
        """Return a place on the road: the map's first spawn point, or the origin."""
        with self._asking("asked for its map"):
            points = self._world.get_map().get_spawn_points()
        return pose_of_transform(points[0]) if points else CarlaPose(0.0, 0.0, 0.0)

    # -- the tick ---------------------------------------------------------------------------------

    def take_over(self, step_s: float) -> None:
        """Make the server wait for this client's tick, each of which is ``step_s`` long."""
        with self._asking("made synchronous"):
            if self._settings is None:
                self._settings = self._world.get_settings()
                self._weather = self._world.get_weather()
                self._keep_left()
            settings = self._world.get_settings()
            settings.synchronous_mode = True
            settings.no_rendering_mode = False
            settings.fixed_delta_seconds = step_s
            substeps = math.ceil(round(step_s / _SUBSTEP_S, 6))
            settings.substepping = substeps <= _MOST_SUBSTEPS
            settings.max_substep_delta_time = _SUBSTEP_S
            settings.max_substeps = min(max(substeps, 1), _MOST_SUBSTEPS)
            settings.deterministic_ragdolls = True
            self._world.apply_settings(settings, self._timeout_s)
            actual_settings = self._world.get_settings()
        if not actual_settings.synchronous_mode or actual_settings.fixed_delta_seconds != step_s:
            raise PeerError(
                f"CARLA server {self.address} didn't become synchronous with a step of {step_s:g} s"
            )

    def tick(self) -> int:
        """Run one frame; its number."""
        with self._asking("ticked"):
            return int(self._world.tick(self._timeout_s))

    def set_weather(self, fields: Mapping[str, float]) -> dict[str, float]:
        """Set the weather, which the server does some ticks later; the weather as read back.

        Raises:
            PeerError: it stays another one.
        """
        with self._asking("given a weather"):
            weather = self._world.get_weather()
            for name, value in fields.items():
                setattr(weather, name, value)
            self._world.set_weather(weather)
        actual_weather: dict[str, float] = {}
        for _ in range(_SETTLE_TICKS):
            self.tick()
            actual_weather = self.weather()
            if all(abs(actual_weather[name] - value) < 1e-3 for name, value in fields.items()):
                return actual_weather
        other = sorted(n for n, value in fields.items() if abs(actual_weather[n] - value) >= 1e-3)
        raise PeerError(f"CARLA server {self.address} doesn't take the weather: {', '.join(other)}")

    def turn_lights_green(self) -> None:
        """Turn all traffic lights green and stop their clocks, until ``close``.

        Raises:
            PeerError: one stays another colour.
        """
        with self._asking("asked for its traffic lights"):
            lights = self._lights or Lights.of_world(self._world)
            self._lights = lights
            self._keep_left()
            lights.turn_green(self._carla, self._world)
        others = len(lights.states)
        for _ in range(_SETTLE_TICKS if others else 0):
            self.tick()
            with self._asking("asked for its traffic lights"):
                others = lights.others_than_green(self._carla, self._world)
            if not others:
                return
        if others:
            raise PeerError(
                f"CARLA server {self.address}: {others} of its {len(lights.states)} traffic lights "
                "don't turn green"
            )

    # -- actors -----------------------------------------------------------------------------------

    def spawn(self, bodies: Sequence[tuple[str, str]]) -> list[int | str]:
        """Spawn actors high above the ground, without physics, and run one frame.

        Args:
            bodies: role name and blueprint of each.

        Returns:
            The id of each, or the server's reason why there is none.
        """
        command, library = self._carla.command, self._blueprint_library()
        batch = []
        for index, (role, name) in enumerate(bodies):
            blueprint = library.find(name)
            if blueprint.has_attribute("role_name"):
                blueprint.set_attribute("role_name", role)
            row, place = divmod(index, _IN_A_ROW)
            where = CarlaPose(place * _APART_M, row * _APART_M, _HIGH_M)
            spawn = command.SpawnActor(blueprint, transform_of(self._carla, where))
            if not name.startswith(PEDESTRIAN_PREFIX):
                spawn = spawn.then(command.SetSimulatePhysics(command.FutureActor, False))
            batch.append(spawn)
        outcomes: list[int | str] = []
        answers = self._batch("told to spawn", batch)
        for (role, _), answer in zip(bodies, answers, strict=True):
            if not answer.error:
                self._spawned.append(int(answer.actor_id))
                self._roles[int(answer.actor_id)] = role
            outcomes.append(str(answer.error) if answer.error else int(answer.actor_id))
        self._keep_left()
        self.tick()
        return outcomes

    def boxes(self, actors: Sequence[int]) -> list[BodyBox]:
        """Measure the boxes of actors that have had a frame."""
        body_boxes = []
        for actor in actors:
            with self._asking(f"asked for the box of {self._actor_name(actor)}"):
                carla_actor = self._world.get_actor(actor)
                box = None if carla_actor is None else carla_actor.bounding_box
            if box is None:
                raise self._lost_actor_error(actor)
            half, at = box.extent, box.location
            body_boxes.append(BodyBox(2 * half.x, 2 * half.y, 2 * half.z, at.x, at.y, at.z))
        return body_boxes

    def measure(self, names: Sequence[str]) -> dict[str, BodyBox]:
        """Measure the boxes of blueprints; one that isn't spawned has none."""
        answers = self.spawn([("ssp_measured", name) for name in names])
        pairs = [(name, a) for name, a in zip(names, answers, strict=True) if isinstance(a, int)]
        boxes = self.boxes([actor for _, actor in pairs])
        self.destroy([actor for _, actor in pairs])
        self.tick()
        return {name: box for (name, _), box in zip(pairs, boxes, strict=True)}

    def destroy(self, actors: Sequence[int]) -> None:
        """Destroy actors; one that isn't destroyed stays among those that ``close`` destroys."""
        command = self._carla.command
        answers = self._batch("told to destroy", [command.DestroyActor(one) for one in actors])
        gone = {one for one, answer in zip(actors, answers, strict=True) if not answer.error}
        self._spawned = [actor for actor in self._spawned if actor not in gone]
        self._check(actors, answers)

    def set_physics(self, actor: int, enabled: bool) -> None:
        """Let an actor fall and roll, or hold it where it is put."""
        command = self._carla.command.SetSimulatePhysics(actor, enabled)
        self._check([actor], self._batch("told to set physics", [command]))

    def step(self, placements: Sequence[Placement], pedals: Sequence[PedalOrder] = ()) -> int:
        """Put actors in their places, press pedals, and run one frame; its number.

        Raises:
            PeerError: one of them isn't where it was put in that frame, or is gone.
        """
        moved: list[Placement | PedalOrder] = [*placements, *pedals]
        commands = [(one.actor, c) for one in moved for c in one.commands(self._carla)]
        answers = self._batch("told to move its actors", [command for _, command in commands])
        self._check([actor for actor, _ in commands], answers)
        frame = self.tick()
        self._check_places(frame, placements)
        return frame

    def pose_of(self, actor: int) -> CarlaPose:
        """Return the pose of an actor in the newest frame."""
        return self.motion_of(actor).pose

    def motion_of(self, actor: int) -> CarlaMotion:
        """Return the motion of an actor in the newest frame."""
        with self._asking("asked for its frame"):
            actor_snapshot = self._world.get_snapshot().find(actor)
        if actor_snapshot is None:
            raise self._lost_actor_error(actor)
        v = actor_snapshot.get_velocity()
        return CarlaMotion(pose_of_transform(actor_snapshot.get_transform()), (v.x, v.y, v.z))

    def _check_places(self, frame: int, placements: Sequence[Placement]) -> None:
        with self._asking("asked for its frame"):
            snapshot = self._world.get_snapshot()
        if int(snapshot.frame) != frame:
            raise PeerError(
                f"CARLA server {self.address} is at frame {snapshot.frame}, not at {frame}: "
                "another client ticks it"
            )
        for one in placements:
            actor_snapshot = snapshot.find(one.actor)
            if actor_snapshot is None:
                raise self._lost_actor_error(one.actor)
            pose = pose_of_transform(actor_snapshot.get_transform())
            off = max(abs(pose.x_m - one.pose.x_m), abs(pose.y_m - one.pose.y_m))
            turn = abs((pose.yaw_deg - one.pose.yaw_deg + 180.0) % 360.0 - 180.0)
            if off > _PLACE_M or turn > _YAW_DEG:
                raise PeerError(
                    f"CARLA server {self.address}, frame {frame}: {self._actor_name(one.actor)} is "
                    f"{off:.3f} m and {turn:.2f} degrees from where it was put"
                )

    def _batch(self, what: str, commands: Sequence[Any]) -> list[Any]:
        if not commands:
            return []
        with self._asking(what):
            return list(self._client.apply_batch_sync(list(commands), False))

    def _check(self, actors: Sequence[int], answers: Sequence[Any]) -> None:
        for actor, answer in zip(actors, answers, strict=True):
            if answer.error:
                raise PeerError(
                    f"CARLA server {self.address} refuses a command for {self._actor_name(actor)}: "
                    f"{answer.error}"
                )

    def _actor_name(self, actor: int) -> str:
        return self._roles.get(actor, f"actor {actor}")

    def _lost_actor_error(self, actor: int) -> PeerError:
        return PeerError(f"CARLA server {self.address}: {self._actor_name(actor)} is gone")

    def _blueprint_library(self) -> Any:
        with self._asking("asked for its blueprints"):
            return self._world.get_blueprint_library()

    # -- pictures ---------------------------------------------------------------------------------

    def start_camera(
        self, attributes: Mapping[str, str], pose: CarlaPose, name: str = CAMERA_BLUEPRINT
    ) -> CarlaCamera:
        """Spawn a camera that is attached to nothing, and tick until it sends a tick's picture.

        Args:
            attributes: of the blueprint, as texts by name.
            pose: in CARLA's frame.
            name: its blueprint.

        Raises:
            PeerError: it doesn't, or the server knows no such attribute.
        """
        with self._asking("asked for its cameras"):
            blueprint = self._world.get_blueprint_library().find(name)
        missing = sorted(one for one in attributes if not blueprint.has_attribute(one))
        if missing:
            raise PeerError(f"CARLA server {self.address}: {name} has no {', '.join(missing)}")
        for attribute, value in attributes.items():
            blueprint.set_attribute(attribute, value)
        with self._asking("told to spawn a camera"):
            sensor = self._world.spawn_actor(blueprint, transform_of(self._carla, pose))
            self._sensors.append(sensor)
            self._spawned.append(int(sensor.id))
            self._roles[int(sensor.id)] = "the camera"
            self._keep_left()
            camera = CarlaCamera(sensor)
        for _ in range(_WARM_UP_TICKS):
            if camera.take(self.tick(), _WARM_UP_WAIT_S) is not None:
                return camera
        raise PeerError(
            f"CARLA server {self.address} sends no pictures of its camera: none of "
            f"{_WARM_UP_TICKS} frames; is it started with -nullrhi or without a GPU?"
        )

    def picture(self, camera: CarlaCamera, frame: int) -> Picture:
        """Wait for the picture of a frame.

        Raises:
            PeerError: it doesn't come.
        """
        image = camera.take(frame, self._timeout_s)
        if image is None:
            raise PeerError(
                f"CARLA server {self.address}: the picture of frame {frame} didn't come within "
                f"{self._timeout_s:g} s (newest: {camera.newest})"
            )
        return image

    def _keep_left(self) -> None:
        if self._settings is not None:
            settings, weather = _fields(self._settings), _numbers(self._weather)
            self._left.write(settings, weather, self._spawned, self._lights)

    # -- the end ----------------------------------------------------------------------------------

    def close(self) -> list[str]:
        """Destroy what was spawned and put the settings back; what couldn't be, in words.

        A server that was lost is asked once more, by a new client, since the old one never finds
        it again. Closing twice does nothing.
        """
        left = self._spawned, self._settings, self._weather
        self._spawned, self._settings, self._weather = [], None, None
        lights, self._lights = self._lights, None
        sensors, self._sensors = self._sensors, []
        if left == ([], None, None):
            return []
        for sensor in sensors:
            with suppress(RuntimeError):
                sensor.stop()
        try:
            if self._lost:
                self._client = self._carla.Client(self.address.host, self.address.port)
                self._client.set_timeout(_RESTORE_S)
                self._world = self._client.get_world()
            destroy = [self._carla.command.DestroyActor(actor) for actor in left[0]]
            if destroy:
                self._client.apply_batch_sync(destroy, False)
            if lights is not None:
                lights.give_back(self._carla, self._world)
            if left[1] is not None:
                self._world.set_weather(left[2])
                self._world.apply_settings(left[1], _RESTORE_S)
            self._left.remove()
        except RuntimeError as error:
            return [
                f"CARLA server {self.address} couldn't be left as it was found: "
                f"{str(error).strip().splitlines()[0]}; restart it"
            ]
        return []


def _fields(structure: Any) -> dict[str, Any]:
    """Return the values of one of CARLA's structures, by name."""
    return {name: getattr(structure, name) for name in dir(structure) if not name.startswith("_")}


def _numbers(structure: Any) -> dict[str, float]:
    return {name: round(v, 6) for name, v in _fields(structure).items() if isinstance(v, float)}


def _set_fields(into: Any, values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        setattr(into, name, value)
