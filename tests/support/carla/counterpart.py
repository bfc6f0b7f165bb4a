"""A counterpart of a CARLA 0.9.16 server, on loopback: what CARLA's own client is spoken to by.

It holds a world of boxes, speaks the wire of 0.9.16 and draws flat pictures (``carla_picture``). It
imports nothing of SSP's. It is strict: a call that it doesn't know, or one with a wrong argument,
is noted, and ``Counterpart`` raises at its end. Like the real server it applies asynchronous
commands 0 to 2 ticks late, at random, and runs its own clock while it isn't synchronous.
"""

from __future__ import annotations

import random
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Any

import msgpack

from tests.support.carla.catalogue import BODIES, INSTANCES, Body, definitions
from tests.support.carla.physics import Drive, Physics
from tests.support.carla.picture import Pose, Solid, draw

VERSION = "0.9.16"
_WORLD_STREAM, _SENSOR_STREAMS = 1, 100
_WORLD_TYPE, _RGB_TYPE, _INSTANCE_TYPE = 17, 13, 15
_FREE_RUNNING_S = 0.02
EMPTY_XODR = (
    '<OpenDRIVE><header revMajor="1" revMinor="4">'
    "<geoReference>+proj=tmerc +lat_0=0 +lon_0=0</geoReference></header></OpenDRIVE>\n"
)


@dataclass
class Behaviour:
    """Departures of a counterpart from a sound server.

    Args:
        xodr: the map's text.
        foreign: actors of somebody else, by blueprint.
        lost, late: pictures by their number from 1: not sent at all; sent behind so many others.
        stall_at, exit_at: picture or tick number at which it hangs, or is gone; 0: never.
        refused: blueprints that it doesn't spawn.
        bodies: boxes that differ from ``BODIES``.
        vanish_at: an actor's role name and the tick at which it is gone.
        batch_error_at: the tick before whose end one batch gets an error for its first command.
        moved_by: m by which each picture shows bodies beside their poses.
        synchronous: somebody left it so.
        physics: of vehicles.
        falls_at: the tick from which the ground is gone from under them.
        stays_red: the traffic lights take no other state.
    """

    version: str = VERSION
    map_name: str = "Carla/Maps/Town01"
    xodr: str = EMPTY_XODR
    foreign: Sequence[str] = ()
    lost: frozenset[int] = frozenset()
    late: dict[int, int] = field(default_factory=dict)
    stall_at: int = 0
    exit_at: int = 0
    refused: frozenset[str] = frozenset()
    bodies: dict[str, Body] = field(default_factory=dict)
    vanish_at: tuple[str, int] = ("", 0)
    batch_error_at: int = 0
    moved_by: float = 0.0
    synchronous: bool = False
    physics: Physics = field(default_factory=Physics)
    falls_at: int = 0
    stays_red: bool = False


@dataclass
class Actor:
    """An actor as the server holds it."""

    actor_id: int
    definition: list[Any]
    attributes: dict[str, list[Any]]
    pose: Pose
    body: Body | None
    stream: int = 0
    physics: bool = True
    lights: int = 0
    drive: Drive = field(default_factory=Drive)

    @property
    def role(self) -> str:
        found = self.attributes.get("role_name")
        return "" if found is None else str(found[2])


class _Wrong(Exception):
    """A call that a real client doesn't make."""


def _pose(raw: Any) -> Pose:
    location, rotation = raw
    return Pose(*(float(v) for v in (*location, *rotation)))


def _wire(pose: Pose) -> list[list[float]]:
    return [[pose.x, pose.y, pose.z], [pose.pitch, pose.yaw, pose.roll]]


def _optional(raw: Any) -> Any:
    return raw[1] if raw[0] else None


def _needs(fine: bool, what: str) -> None:
    if not fine:
        raise _Wrong(what)


class Counterpart:
    """A server from ``with`` to its end; ``port`` is its RPC port, the next one its streams'."""

    def __init__(self, behaviour: Behaviour | None = None, seed: int = 1) -> None:
        self.behaviour = behaviour or Behaviour()
        self.wrong: list[str] = []
        self.calls: list[str] = []
        self.ticks = 0
        self.pictures = 0
        self.actors: dict[int, Actor] = {}
        # Role, height of the feet and speed of each state of a walker.
        self.walks: list[tuple[str, float, float]] = []
        self.frame, self.elapsed_s = 1000 + seed, 12.5
        # Fields of the episode's settings, of which the first is synchronous_mode, the third the
        # step; the numbers at the end are for large maps.
        self.settings: list[Any] = [
            self.behaviour.synchronous,
            False,
            [False],
            True,
            0.01,
            10,
            0.0,
            True,
            3000.0,
            2000.0,
            True,
        ]
        self.weather = [-1.0] * 13 + [0.0]
        self.left_settings = list(self.settings)
        self._random = random.Random(seed)
        self._definitions = definitions()
        self._late: list[tuple[int, Callable[[], None]]] = []
        self._held: list[tuple[int, bytes, int]] = []
        self._episode, self._next_id = 7, 20
        self._cues = 0
        self._loaded = ""
        self._state = threading.RLock()
        self._cue = threading.Condition(self._state)
        self._streams: dict[int, list[socket.socket]] = {}
        self._sockets: list[socket.socket] = []
        self._over = False
        self._add("spectator", Pose(z=50.0))
        # Numbers of carla.TrafficLightState by actor: red, and green in the other direction.
        at = Pose(x=30.0, y=8.0), Pose(x=30.0, y=-8.0)
        lights = [self._add("traffic.traffic_light", pose).actor_id for pose in at]
        self.lights = dict(zip(lights, (0, 2), strict=True))
        self.lights_stopped = False
        self.left_lights = dict(self.lights)
        for blueprint in self.behaviour.foreign:
            self._add(blueprint, Pose(x=200.0))

    # -- life -------------------------------------------------------------------------------------

    def __enter__(self) -> Counterpart:
        rpc, streams = self._listeners()
        self.port = int(rpc.getsockname()[1])
        for listener, serve in ((rpc, self._serve_rpc), (streams, self._serve_stream)):
            self._start(self._accept, listener, serve)
        self._start(self._run_world)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.leave()
        if kind is None and self.wrong:
            raise AssertionError("a real client doesn't call so:\n" + "\n".join(self.wrong))

    def leave(self) -> None:
        """Be gone, as a server that was killed."""
        with self._cue:
            self._over = True
            self._cue.notify_all()
            for one in self._sockets:
                with suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)
                one.close()

    def settle(self, patience_s: float) -> None:
        """Wait until every asynchronous command has taken effect."""
        with self._cue:
            assert self._cue.wait_for(lambda: not self._late, patience_s)

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    def _listeners(self) -> tuple[socket.socket, socket.socket]:
        """Two listening sockets on neighbouring ports."""
        for _ in range(100):
            first, second = socket.socket(), socket.socket()
            self._sockets += [first, second]
            try:
                first.bind(("127.0.0.1", 0))
                second.bind(("127.0.0.1", first.getsockname()[1] + 1))
            except OSError:
                continue
            first.listen()
            second.listen()
            return first, second
        raise RuntimeError("no two free ports beside each other")

    def _start(self, work: Callable[..., None], *given: Any) -> None:
        threading.Thread(target=work, args=given, daemon=True).start()

    def _accept(self, listener: socket.socket, serve: Callable[[socket.socket], None]) -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with self._state:
                self._sockets.append(connection)
            self._start(serve, connection)

    # -- calls ------------------------------------------------------------------------------------

    def _serve_rpc(self, connection: socket.socket) -> None:
        unpacker = msgpack.Unpacker(raw=False, strict_map_key=False)
        with suppress(OSError):
            while data := connection.recv(1 << 16):
                unpacker.feed(data)
                for request in unpacker:
                    answer = self._answer(request)
                    if answer is not None:
                        connection.sendall(answer)

    def _answer(self, request: Any) -> bytes | None:
        kind, number, name, ((asynchronous,), *given) = request
        self.calls.append(name)
        result: Any = None
        error: Any = None
        try:
            _needs(kind == 0, f"message of type {kind}")
            method = getattr(self, f"_on_{name}", None)
            _needs(method is not None, "unknown")
            with self._state:
                result = method(asynchronous, *given)
        except (_Wrong, TypeError, ValueError, KeyError, IndexError) as fault:
            self.wrong.append(f"{name}{tuple(given)!r:.300}: {fault}")
            error = str(fault)
        if self._hangs:
            return None
        packed: bytes = msgpack.packb([1, number, error, result], use_bin_type=True)
        return packed

    @property
    def _hangs(self) -> bool:
        return 0 < self.behaviour.stall_at <= self.ticks + self._cues

    @staticmethod
    def _ok(value: Any) -> Any:
        return [[1, value]]

    @staticmethod
    def _refuse(text: str) -> Any:
        return [[0, [text]]]

    def _token(self, stream: int) -> bytes:
        address = socket.inet_aton("127.0.0.1") + bytes(12)
        return struct.pack("<IHBB", stream, self.port + 1, 1, 1) + address

    def _on_version(self, _: bool) -> Any:
        return self._ok(self.behaviour.version)

    def _on_get_episode_info(self, _: bool) -> Any:
        return self._ok([self._episode, [self._token(_WORLD_STREAM)]])

    def _on_get_sensor_token(self, _: bool, stream: int) -> Any:
        return self._ok([self._token(stream)])

    def _on_get_episode_settings(self, _: bool) -> Any:
        return self._ok(self.settings)

    def _on_set_episode_settings(self, _: bool, settings: list[Any]) -> Any:
        _needs(len(settings) == len(self.settings), "settings have 11 fields")
        self.settings = settings
        self._cue.notify_all()
        return self._ok(self.frame)

    def _on_get_required_files(self, _: bool, folder: str) -> Any:
        _needs(folder in ("", "Nav"), "no such folder")
        return self._ok([])

    def _on_query_lights_state(self, _: bool, client: str) -> Any:
        return self._ok([])

    def _on_get_map_info(self, _: bool) -> Any:
        start = _wire(Pose(x=20.0, y=3.5, z=0.0, yaw=90.0))
        return self._ok([self.behaviour.map_name, [start]])

    def _on_get_map_data(self, _: bool) -> Any:
        return self._ok(self.behaviour.xodr)

    def _on_copy_opendrive_to_file(self, _: bool, text: str, built: list[Any]) -> Any:
        _needs(len(built) == 7, "a world of OpenDRIVE is built by 7 parameters")
        self._loaded = text
        return [[False]]

    def _on_load_new_episode(self, _: bool, name: str, reset: bool, layers: int) -> Any:
        _needs(name == "OpenDriveMap" and bool(self._loaded), "only a world of OpenDRIVE is loaded")
        self.behaviour.map_name, self.behaviour.xodr = f"Carla/Maps/{name}", self._loaded
        self._episode += 1
        return [[False]]

    def _on_get_actor_definitions(self, _: bool) -> Any:
        return self._ok(self._definitions)

    def _on_get_actors_by_id(self, _: bool, ids: list[int]) -> Any:
        return self._ok([self._told(self.actors[i]) for i in ids if i in self.actors])

    def _on_get_actor_bounding_box(self, _: bool, actor: int) -> Any:
        found = self.actors.get(actor)
        return self._refuse("actor not found") if found is None else self._ok(self._box(found))

    def _on_get_weather_parameters(self, _: bool) -> Any:
        return self._ok(self.weather)

    def _on_set_weather_parameters(self, asynchronous: bool, weather: list[float]) -> Any:
        _needs(asynchronous and len(weather) == len(self.weather), "weather has 14 fields")

        def change() -> None:
            self.weather = weather

        self._later(change)
        return [[False]]

    def _on_tick_cue(self, _: bool) -> Any:
        _needs(bool(self.settings[0]), "ticks a world that isn't synchronous")
        self._cues += 1
        self._cue.notify_all()
        return self._ok(self.frame + self._cues)

    def _on_spawn_actor(self, _: bool, description: list[Any], transform: Any) -> Any:
        found = self._spawn(description, _pose(transform))
        return self._refuse(found) if isinstance(found, str) else self._ok(self._told(found))

    def _on_destroy_actor(self, _: bool, actor: int) -> Any:
        return self._ok(self._destroy(actor))

    def _on_freeze_all_traffic_lights(self, asynchronous: bool, stopped: bool) -> Any:
        _needs(asynchronous, "waits for the traffic lights")

        def change() -> None:
            self.lights_stopped = stopped

        self._later(change)
        return [[False]]

    def _on_set_traffic_light_state(self, asynchronous: bool, actor: int, state: int) -> Any:
        _needs(asynchronous and actor in self.lights and 0 <= state <= 4, "no such traffic light")

        def change() -> None:
            if not self.behaviour.stays_red:
                self.lights[actor] = state

        self._later(change)
        return [[False]]

    def _on_set_actor_transform(self, asynchronous: bool, actor: int, transform: Any) -> Any:
        pose = _pose(transform)
        self._later(lambda: self._place(actor, pose))
        return [[False]]

    def _on_apply_batch(self, asynchronous: bool, commands: list[Any], do_tick: bool) -> Any:
        _needs(do_tick is False, "0.9.16 ticks by a cue of its own")
        fails = self.behaviour.batch_error_at
        if fails and self.ticks + 1 >= fails and commands:
            self.behaviour.batch_error_at = 0
            return [self._refuse("the actor is busy"), *map(self._command, commands[1:])]
        if asynchronous:
            self._later(lambda: [self._command(one) for one in commands] and None)
            return []
        return [self._command(one) for one in commands]

    def _command(self, command: Any, future: int = 0) -> Any:
        ((index, fields),) = command
        if index == 0:
            description, transform, parent, *_, after = fields
            _needs(_optional(parent) is None, "no actor has a parent here")
            found = self._spawn(description, _pose(transform))
            if isinstance(found, str):
                return self._refuse(found)
            for one in after:
                self._command(one, found.actor_id)
            return self._ok(found.actor_id)
        actor_id = fields[0] or future
        actor = self.actors.get(actor_id)
        if actor is None:
            return self._refuse(f"unable to find actor {actor_id}")
        match index:
            case 1:
                self._destroy(actor_id)
            case 2:
                _needs(not (wrong := actor.drive.told(fields[1])), wrong)
            case 6:
                self._place(actor_id, _pose(fields[1]))
            case 7:
                _needs(actor.body is not None and actor.body.kind == "pedestrian", "no walker")
                assert actor.body is not None
                feet = _pose(fields[1])
                self.walks.append((actor.role, feet.z, float(fields[2])))
                self._place(actor_id, replace(feet, z=feet.z + actor.body.extent[2]))
            case 14:
                actor.physics = bool(fields[1])
            case 18:
                actor.lights = int(fields[1])
            case _:
                raise _Wrong(f"command {index}")
        return self._ok(actor_id)

    # -- the world --------------------------------------------------------------------------------

    def _add(self, blueprint: str, pose: Pose, attributes: list[list[Any]] | None = None) -> Actor:
        known = [d for d in self._definitions if d[1] == blueprint]
        definition = known[0] if known else [0, blueprint, "", []]
        body = next((b for b in BODIES if b.blueprint == blueprint), None)
        body = self.behaviour.bodies.get(blueprint, body)
        self._next_id += 1
        stream = _SENSOR_STREAMS + self._next_id if blueprint.startswith("sensor.") else 0
        named = {one[0]: one for one in attributes or []}
        actor = Actor(self._next_id, definition, named, pose, body, stream)
        self.actors[actor.actor_id] = actor
        return actor

    def _spawn(self, description: list[Any], pose: Pose) -> Actor | str:
        uid, blueprint, attributes = description
        (definition,) = (d for d in self._definitions if d[0] == uid)
        _needs(definition[1] == blueprint, f"{blueprint} has another uid")
        known = {one[0]: one for one in definition[3]}
        for name, kind, value in attributes:
            _needs(name in known and known[name][1] == kind, f"attribute {name}")
            _needs(known[name][4] or value == known[name][2], f"attribute {name} can't be changed")
        if blueprint in self.behaviour.refused:
            return "Spawn failed because of collision at spawn position"
        return self._add(blueprint, pose, attributes)

    def _destroy(self, actor_id: int) -> bool:
        actor = self.actors.pop(actor_id, None)
        return actor is not None

    def _told(self, actor: Actor) -> list[Any]:
        uid, blueprint = actor.definition[:2]
        token = self._token(actor.stream) if actor.stream else b""
        described = [uid, blueprint, list(actor.attributes.values())]
        return [actor.actor_id, 0, described, self._box(actor), b"", token]

    @staticmethod
    def _box(actor: Actor) -> Any:
        body = actor.body
        extent, offset = (body.extent, body.offset) if body else ((0.0,) * 3, (0.0,) * 3)
        return [list(offset), list(extent), [0.0, 0.0, 0.0], actor.actor_id]

    def _place(self, actor_id: int, pose: Pose) -> None:
        if actor_id in self.actors:
            self.actors[actor_id].pose = pose
            self.actors[actor_id].drive.stop()

    def _later(self, change: Callable[[], None]) -> None:
        """Apply an asynchronous command, 0 to 2 ticks late."""
        self._late.append((self.frame + 1 + self._random.randrange(3), change))

    def _run_world(self) -> None:
        while True:
            with self._cue:
                if self.settings[0]:
                    self._cue.wait_for(lambda: self._over or self._cues or not self.settings[0])
                if self._over:
                    return
                if not (self._hangs and self.settings[0]):
                    self._tick()
                free = not self.settings[0] or self._hangs
            if free:
                time.sleep(_FREE_RUNNING_S)

    def _tick(self) -> None:
        if self.settings[0] and not self._cues:
            return
        self._cues = max(0, self._cues - 1)
        step_s = _optional(self.settings[2]) or _FREE_RUNNING_S
        self.frame += 1
        self.elapsed_s += step_s
        self.ticks += bool(self.settings[0])
        role, tick = self.behaviour.vanish_at
        if tick and self.ticks >= tick:
            for actor in [a for a in self.actors.values() if a.role == role]:
                self._destroy(actor.actor_id)
        for due, change in self._late:
            if due <= self.frame:
                change()
        self._late = [one for one in self._late if one[0] > self.frame]
        self._cue.notify_all()
        for actor in self.actors.values():
            if actor.body is not None and actor.physics and actor.body.kind != "pedestrian":
                actor.pose = actor.drive.step(actor.pose, self.behaviour.physics, step_s)
                if 0 < self.behaviour.falls_at <= self.ticks:
                    actor.pose = replace(actor.pose, z=-3.0)
        if self.behaviour.exit_at and self.ticks >= self.behaviour.exit_at:
            self.leave()
            return
        self._send(_WORLD_STREAM, self._snapshot(step_s))
        for actor in list(self.actors.values()):
            if actor.stream and self._streams.get(actor.stream):
                self._send_picture(actor)

    def _header(self, kind: int, pose: Pose) -> bytes:
        numbers = (pose.x, pose.y, pose.z, pose.pitch, pose.yaw, pose.roll)
        return struct.pack("<QQd6f", kind, self.frame, self.elapsed_s, *numbers)

    def _snapshot(self, step_s: float) -> bytes:
        told = [self._header(_WORLD_TYPE, Pose())]
        wall_s = time.monotonic()
        told.append(struct.pack("<Qdf3iI", self._episode, wall_s, step_s, 0, 0, 0, 0))
        for one in self.actors.values():
            p = one.pose
            place = (p.x, p.y, p.z, p.pitch, p.yaw, p.roll)
            moved = (*one.drive.velocity, *([0.0] * 6))
            state = bytes(54)
            if one.actor_id in self.lights:
                # Sign, times of green, yellow and red, elapsed time and pole, before them.
                state = bytes(52) + bytes((self.lights_stopped, self.lights[one.actor_id]))
            told.append(struct.pack("<IB15f", one.actor_id, 1, *place, *moved) + state)
        return b"".join(told)

    def _send_picture(self, camera: Actor) -> None:
        self.pictures += 1
        number, said = self.pictures, self.behaviour
        wanted = {name: value for name, _, value in camera.attributes.values()}
        size = int(wanted["image_size_x"]), int(wanted["image_size_y"])
        fov = float(wanted["fov"])
        solids = [
            Solid(
                one.actor_id,
                one.body.kind,
                replace(one.pose, x=one.pose.x + said.moved_by),
                one.body.offset,
                one.body.extent,
            )
            for one in self.actors.values()
            if one.body is not None
        ]
        instances = camera.definition[1] == INSTANCES
        pixels = draw(camera.pose, fov, size, solids, None if instances else self.frame)
        kind = _INSTANCE_TYPE if instances else _RGB_TYPE
        message = self._header(kind, camera.pose)
        message += struct.pack("<IIf", *size, fov)
        message += pixels.tobytes()
        due = [one for one in self._held if one[2] <= number]
        self._held = [one for one in self._held if one[2] > number]
        if number in said.late:
            self._held.append((camera.stream, message, number + said.late[number]))
        elif number not in said.lost:
            self._send(camera.stream, message)
        for stream, held, _ in due:
            self._send(stream, held)

    # -- streams ----------------------------------------------------------------------------------

    def _serve_stream(self, connection: socket.socket) -> None:
        with suppress(OSError, struct.error):
            (stream,) = struct.unpack("<I", connection.recv(4, socket.MSG_WAITALL))
            with self._state:
                self._streams.setdefault(stream, []).append(connection)
            connection.recv(1)

    def _send(self, stream: int, message: bytes) -> None:
        for connection in list(self._streams.get(stream, [])):
            try:
                connection.sendall(struct.pack("<I", len(message)) + message)
            except OSError:
                self._streams[stream].remove(connection)
