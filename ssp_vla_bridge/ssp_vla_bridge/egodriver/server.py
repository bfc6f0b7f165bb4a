"""One of our bridges behind an EgodriverService.

The package's servicer keeps sessions, frames and motion, and turns plans of the rig into local
ones. A session has a model's process of its own, which ends with it.
"""

from __future__ import annotations

import errno
import math
import socket
import threading
import time
from collections.abc import Iterator
from concurrent import futures
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import cv2
import grpc  # type: ignore[import-untyped] # has no types
import numpy as np
from carla_driver_interface import protocol as proto
from carla_driver_interface.contract import contract_metadata
from carla_driver_interface.driver import (
    BaseDriver,
    CameraFrame,
    DriveContext,
    DriveResult,
    SessionState,
)
from carla_driver_interface.geometry import Trajectory as RigTrajectory
from carla_driver_interface.service import EgodriverServicer, ServiceMode

from ssp_core import __version__
from ssp_core.errors import HostError, InputError
from ssp_core.world.driver import Answer
from ssp_vla_bridge.driving.driver import BridgeDriver, DriverModel, history_by
from ssp_vla_bridge.egodriver import exact, wire
from ssp_vla_bridge.egodriver.channel import limits
from ssp_vla_bridge.egodriver.options import FORWARD_CAMERA, is_loopback
from ssp_vla_bridge.egodriver.tls import read_pair
from ssp_vla_bridge.messages import CameraGeometry, EgoSample, Frame, Request
from ssp_vla_bridge.window import choose

# Frames of a session that are kept: so many at least, and so many for each that a request holds,
# since a client may send them faster.
_KEPT_FRAMES, _PER_FRAME = 16, 4
# An older newest pose says nothing of how the vehicle moves now.
_POSE_AGE_US = 300_000
_JPEG = b"\xff\xd8"
_JPEG_QUALITY = 95
# A session without a call for so long gives its place to a new one: its client is gone.
_IDLE_S = 600.0
# Calls that are answered at the same time; a further one waits.
_WORKERS = 32
_GRACE_S = 1.0


@dataclass
class _Seat:
    """One session of a bridge.

    Args:
        driver: its model, in a process of its own.
        camera: name of the camera that it sees by.
        geometry: of the camera.
        motion: to the last bit, from a client of ours; None: it sent none.
        is_exact: its client is one of ours.
        answer: the last one.
        used_s: time of the last call, monotonic.
    """

    driver: BridgeDriver
    camera: str
    geometry: CameraGeometry
    motion: bytes | None = None
    is_exact: bool = False
    answer: Answer | None = None
    used_s: float = field(default_factory=time.monotonic)
    lock: threading.Lock = field(default_factory=threading.Lock)


class BridgePolicy(BaseDriver):
    """A bridge as a policy of the service.

    Args:
        model: of the bridge.
        camera: name of the camera that it sees by; empty: the only one, or the forward one.
        most_sessions: at a time.
    """

    def __init__(self, model: DriverModel, camera: str = "", most_sessions: int = 8) -> None:
        self.name = model.name
        self.frame_history_length = max(_KEPT_FRAMES, _PER_FRAME * model.rules.frames)
        self._model, self._camera, self._most = model, camera, most_sessions
        self._seats: dict[str, _Seat] = {}
        self._begins = threading.Lock()
        self._loading = 0
        # What clients of ours sent beside the message that is being handled.
        self.sent_camera: dict[str, bytes] = {}

    def seat(self, session: str) -> _Seat | None:
        """Return a session's seat; None: there is no such session."""
        return self._seats.get(session)

    def on_session_start(self, session: SessionState) -> None:
        """Load the model for a session.

        Raises:
            ValueError: its cameras aren't what the bridge can see by, the model can't be loaded, or
                there are as many sessions as there may be.
        """
        name = self._chosen(sorted(session.cameras))
        try:
            geometry = wire.geometry_of_camera(session.cameras[name])
        except ValueError as error:
            raise ValueError(f"the camera {name!r} {error}") from error
        sent = self.sent_camera.pop(session.uuid, None)
        if sent is not None:
            geometry = exact.unpack_camera(sent, geometry)
        with self._begins:
            self._make_room()
            self._loading += 1
        seat = None
        try:
            driver = BridgeDriver(self._model)
            if driver.problem:
                driver.close()
                raise ValueError(f"the model can't be loaded: {driver.problem}")
            seat = _Seat(driver, name, geometry, is_exact=sent is not None)
        finally:
            with self._begins:  # at once, or another start would count it twice
                self._loading -= 1
                if seat is not None:
                    self._seats[session.uuid] = seat

    def _make_room(self) -> None:
        if len(self._seats) + self._loading < self._most:
            return
        if not self._seats:
            raise ValueError(f"{self._most} sessions begin, which is the most there may be")
        uuid, seat = min(self._seats.items(), key=lambda item: item[1].used_s)
        if time.monotonic() - seat.used_s < _IDLE_S:
            raise ValueError(f"there are {self._most} sessions already, which is the most")
        self._end(uuid)

    def _end(self, uuid: str) -> None:
        seat = self._seats.pop(uuid, None)
        if seat is not None:
            with seat.lock:
                seat.driver.close()

    def _chosen(self, names: list[str]) -> str:
        wanted = self._camera or (FORWARD_CAMERA if len(names) != 1 else names[0])
        if wanted not in names:
            raise ValueError(
                f"no camera {wanted!r} is declared, but {', '.join(names) or 'none'}; "
                "ssp driver serve --camera names the one to see by"
            )
        return wanted

    def on_session_close(self, session: SessionState) -> None:
        """End a session's model."""
        self._end(session.uuid)

    def close(self) -> None:
        """End all sessions."""
        for uuid in list(self._seats):
            self._end(uuid)

    def drive(self, ctx: DriveContext) -> DriveResult:
        """Ask the bridge; what isn't a plan is an empty one.

        Raises:
            RuntimeError: the model ended, with its reason.
        """
        seat = self.seat(ctx.session.uuid)
        if seat is None:
            raise RuntimeError(f"the session is over: it had no call for {_IDLE_S:g} s")
        with seat.lock:
            seat.used_s = time.monotonic()
            request = self._request(seat, ctx)
            seat.answer = None
            if request is None:
                return DriveResult(RigTrajectory.empty())
            given = seat.driver.ask(request)
        answer = given.answer
        if answer is None:
            raise RuntimeError(given.ended)
        seat.answer = answer
        plan = answer.trajectory
        if plan is None or answer.refused or not _is_sendable(plan.t_s, plan.x_m, plan.y_m):
            return DriveResult(RigTrajectory.empty())
        return DriveResult(wire.plan_in_rig(plan, ctx.time_now_us))

    def _request(self, seat: _Seat, ctx: DriveContext) -> Request | None:
        """Return the request of one call; None while no frame or motion was sent."""
        session, now_us, rules = ctx.session, ctx.time_now_us, self._model.rules
        with session.lock:
            kept = [
                one
                for one in session.frame_history[seat.camera]
                if isinstance(one, CameraFrame) and one.timestamp_us <= now_us
            ]
            times = list(session.ego_trajectory.timestamps_us)
            poses = list(session.ego_trajectory.poses)
            states = list(session.dynamic_states)
        if not kept or not times:
            return None
        stamps_ns = [one.timestamp_us * 1000 for one in kept]
        chosen = choose(stamps_ns, len(kept) - 1, rules)
        samples: tuple[Any, ...] = ()
        if now_us - times[-1] <= _POSE_AGE_US:
            first = max(0, len(times) - 1000)
            samples = wire.samples_of(times[first:], poses[first:], states[first:], times[-1])
            if seat.motion is not None:
                samples = exact.unpack_motion(seat.motion, samples)
        history: tuple[EgoSample, ...] = history_by(samples, rules) if samples else ()
        return Request(
            request_id=str(session.drive_count + 1),
            stamp_ns=now_us * 1000,
            frames=tuple(Frame(stamps_ns[i], _jpeg(kept[i].image_bytes)) for i in chosen),
            camera=seat.geometry,
            history=history,
            ego_provenance="measured" if history else "unknown",
            task=self._model.task,
        )


def _is_sendable(*columns: tuple[float, ...]) -> bool:
    """Tell whether a plan can stand in a message: of equal lengths, all finite, in µs."""
    return len(set(map(len, columns))) == 1 and all(
        math.isfinite(value) and abs(value) < 1e6 for column in columns for value in column
    )


def _jpeg(picture: bytes) -> bytes:
    """Return a picture as JPEG, of whichever kind it came."""
    if picture.startswith(_JPEG):
        return picture
    pixels = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    if pixels is None:
        raise ValueError("a frame is no picture that can be read")
    return bytes(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1])


class BridgeServicer(EgodriverServicer):
    """The package's servicer, which also understands the values that clients of ours send."""

    def __init__(self, policy: BridgePolicy, mode: ServiceMode) -> None:
        super().__init__(policy, mode)
        self._policy = policy

    def get_version(self, _request: proto.Empty, context: grpc.ServicerContext) -> proto.VersionId:
        """Say which policy this is, the contract's revision, and that exact values are read."""
        context.send_initial_metadata((*contract_metadata(), (exact.EXACT, "1")))
        return proto.VersionId(
            version_id=f"{self._policy.name}-ssp-{__version__}",
            git_hash=proto.ALPASIM_REV,
            grpc_api_version=proto.ALPASIM_API_VERSION,
        )

    def start_session(
        self, request: proto.DriveSessionRequest, context: grpc.ServicerContext
    ) -> proto.SessionRequestStatus:
        """Begin a session."""
        sent = _metadata(context, exact.CAMERA)
        if sent is not None:
            self._policy.sent_camera[request.session_uuid] = sent
        try:
            return super().start_session(request, context)
        finally:
            self._policy.sent_camera.pop(request.session_uuid, None)

    def submit_egomotion_observation(
        self, request: proto.RolloutEgoTrajectory, context: grpc.ServicerContext
    ) -> proto.Empty:
        """Take the vehicle's motion."""
        seat = self._policy.seat(request.session_uuid)
        if seat is not None:
            seat.motion = _metadata(context, exact.MOTION)
        return super().submit_egomotion_observation(request, context)

    def drive(
        self, request: proto.DriveRequest, context: grpc.ServicerContext
    ) -> proto.DriveResponse:
        """Answer with a plan; a client of ours gets it to the last bit, with its text."""
        try:
            response = super().drive(request, context)
        except (RuntimeError, ValueError) as error:
            context.abort(grpc.StatusCode.INTERNAL, str(error))
        if len(response.trajectory.poses) == 1:
            # The package leads even an empty plan by the present pose.
            response.trajectory.Clear()
        seat = self._policy.seat(request.session_uuid)
        if seat is not None and seat.is_exact and seat.answer is not None:
            said = _exact_answer(seat.answer, is_sent=bool(response.trajectory.poses))
            if len(said) <= wire.MOST_TEXT_BYTES:
                response.debug_info.unstructured_debug_info = said
        return response


def _exact_answer(answer: Answer, *, is_sent: bool) -> bytes:
    if is_sent:
        return exact.answer_json(answer.text, "", answer.trajectory)
    return exact.answer_json(answer.text, answer.refused or "its plan can't be sent", None)


def _metadata(context: grpc.ServicerContext, key: str) -> bytes | None:
    """Return a value that a client sent beside its message; None: it sent none."""
    found = [value for known, value in context.invocation_metadata() if known == key]
    return found[0] if found and isinstance(found[0], bytes) else None


@dataclass(frozen=True)
class Listening:
    """The place where a server listens.

    Args:
        host: loopback, unless ``insecure`` or with a certificate.
        port: 0: any free one.
        certificate: file (PEM) that clients check it by; empty: plain text.
        key: file (PEM) of the certificate's key.
        insecure: plain text on a host that isn't loopback.
    """

    host: str = "127.0.0.1"
    port: int = 50051
    certificate: str = ""
    key: str = ""
    insecure: bool = False


@contextmanager
def serving(policy: BridgePolicy, mode: ServiceMode, at: Listening) -> Iterator[str]:
    """Serve a bridge as long as the block runs, which gets the address.

    Args:
        policy: the bridge.
        mode: of clients that declare no revision: alpasim, or carla for the revision before.
        at: where to listen.

    Raises:
        InputError: the host isn't loopback, or a file can't be read.
        HostError: the host isn't this machine's, or the port is taken.
    """
    if not (at.certificate or at.insecure or is_loopback(at.host)):
        raise InputError(
            "isn't loopback, and the connection would be neither encrypted nor checked",
            field="--host",
            value=at.host,
            remedy="give --tls-certificate and --tls-key, or ask for it by --insecure",
        )
    # A port that another server has is taken, and not shared with it.
    settings = [*limits(), ("grpc.so_reuseport", 0)]
    server = grpc.server(futures.ThreadPoolExecutor(_WORKERS), options=settings)
    servicer = BridgeServicer(policy, mode)
    proto.add_EgodriverServiceServicer_to_server(servicer, server)  # type: ignore[no-untyped-call] # generated without types
    proto.add_CarlaVehicleServiceServicer_to_server(servicer, server)  # type: ignore[no-untyped-call] # likewise
    place = f"[{at.host}]" if ":" in at.host else at.host
    try:
        port = _bound(server, f"{place}:{at.port}", at)
    except RuntimeError as error:
        raise HostError(f"can't listen on {place}:{at.port}: {_not_bound(at)}") from error
    server.start()
    try:
        yield f"grpc://{place}:{port}"
    finally:
        server.stop(_GRACE_S).wait()
        policy.close()


def _bound(server: grpc.Server, address: str, at: Listening) -> int:
    if not at.certificate:
        return int(server.add_insecure_port(address))
    pair = read_pair(at.certificate, at.key)
    return int(server.add_secure_port(address, grpc.ssl_server_credentials([pair])))


def _not_bound(at: Listening) -> str:
    """Return why a place can't be listened on, with the remedy: gRPC doesn't say it."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            at.host, at.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with socket.socket(family, kind, protocol) as tried:
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind(address)
            tried.listen()
    except OSError as error:
        is_port = error.errno in (errno.EADDRINUSE, errno.EACCES)
        return f"{error.strerror}; give another {'--port' if is_port else '--host'}"
    return "gRPC gives no reason; give another --port or --host"
