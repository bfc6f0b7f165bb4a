"""The server of a bridge: AlpaSim's EgodriverService over gRPC.

The package's servicer keeps sessions, frames and motion, and turns plans of the rig into local
ones; its sessions begin and end with the seats of the policy.
"""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator
from concurrent import futures
from contextlib import contextmanager
from dataclasses import dataclass

import grpc  # type: ignore[import-untyped] # has no types
from carla_driver_interface import protocol as proto
from carla_driver_interface.contract import contract_metadata
from carla_driver_interface.service import EgodriverServicer, ServiceMode

from ssp_core import __version__
from ssp_core.addresses import resolve
from ssp_core.errors import HostError, InputError
from ssp_core.world.driver import Answer
from ssp_vla_bridge.egodriver import exact, wire
from ssp_vla_bridge.egodriver.channel import limits
from ssp_vla_bridge.egodriver.options import is_loopback
from ssp_vla_bridge.egodriver.policy import EXISTS, BridgePolicy, Seat
from ssp_vla_bridge.egodriver.tls import read_pair

# Calls that are answered at the same time, beside one per session, and those that may wait for it.
_WORKERS, _WAITING = 8, 64
_GRACE_S = 1.0
# Of one message.
_MOST_POSES = 10_000


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
        """Begin a session; one whose client doesn't wait any more ends at once."""
        uuid = request.session_uuid
        seat = Seat(context.is_active, _metadata(context, exact.CAMERA))
        why, idle = self._policy.take(uuid, seat)
        while idle:
            super().close_session(proto.DriveSessionCloseRequest(session_uuid=idle), context)
            why, idle = self._policy.take(uuid, seat)
        if why:
            exists, full = grpc.StatusCode.ALREADY_EXISTS, grpc.StatusCode.RESOURCE_EXHAUSTED
            context.abort(exists if why == EXISTS else full, why)
        try:
            with _answered(context, grpc.StatusCode.INVALID_ARGUMENT):
                status = super().start_session(request, context)
        except Exception:  # of whatever kind, it hasn't begun
            self._policy.leave(uuid)
            raise
        if not context.is_active():
            super().close_session(proto.DriveSessionCloseRequest(session_uuid=uuid), context)
        return status

    def submit_egomotion_observation(
        self, request: proto.RolloutEgoTrajectory, context: grpc.ServicerContext
    ) -> proto.Empty:
        """Take the vehicle's motion."""
        count = len(request.trajectory.poses)
        if count > _MOST_POSES:
            invalid = grpc.StatusCode.INVALID_ARGUMENT
            context.abort(invalid, f"{count} poses, at most {_MOST_POSES} in a message")
        seat = self._policy.seat(request.session_uuid)
        if seat is not None:
            seat.motion = _metadata(context, exact.MOTION)
            seat.lacks_speeds |= len(request.dynamic_states) < count
        with _answered(context, grpc.StatusCode.INVALID_ARGUMENT):
            return super().submit_egomotion_observation(request, context)

    def drive(
        self, request: proto.DriveRequest, context: grpc.ServicerContext
    ) -> proto.DriveResponse:
        """Answer with a plan; a client of ours gets it to the last bit, with its text."""
        with _answered(context, grpc.StatusCode.INTERNAL):
            response = super().drive(request, context)
        if len(response.trajectory.poses) == 1:
            # The package leads even an empty plan by the present pose.
            response.trajectory.Clear()
        seat = self._policy.seat(request.session_uuid)
        answer = self._policy.last_answer
        if seat is not None and seat.sent_camera is not None and answer is not None:
            is_sent = bool(response.trajectory.poses)
            response.debug_info.unstructured_debug_info = _exact_answer(answer, is_sent=is_sent)
        return response


@contextmanager
def _answered(context: grpc.ServicerContext, code: grpc.StatusCode) -> Iterator[None]:
    """Answer a message that can't be handled with the reason; what aborts a call is passed on."""
    try:
        yield
    except (
        ArithmeticError,
        LookupError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:
        context.abort(code, str(error) or type(error).__name__)


def _exact_answer(answer: Answer, *, is_sent: bool) -> bytes:
    """Return what a client of ours gets beside the plan; of what is too long nothing."""
    plan = answer.trajectory if is_sent else None
    refused = "" if is_sent else answer.refused or "its plan can't be sent"
    payload = exact.answer_json(answer.text, refused, plan)
    if len(payload) <= wire.MOST_TEXT_BYTES:
        return payload
    left_out = f"{len(answer.text.encode())} bytes, with its plan more than {wire.MOST_TEXT_BYTES}"
    payload = exact.answer_json("", refused, plan, left_out)
    return payload if len(payload) <= wire.MOST_TEXT_BYTES else b""


def _metadata(context: grpc.ServicerContext, key: str) -> bytes | None:
    """Return a value that a client sent beside its message; None: it sent none."""
    values = [value for name, value in context.invocation_metadata() if name == key]
    return values[0] if values and isinstance(values[0], bytes) else None


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
    workers = policy.most_sessions + _WORKERS
    server = grpc.server(
        futures.ThreadPoolExecutor(workers),
        options=settings,
        # Each holds its message.
        maximum_concurrent_rpcs=workers + _WAITING,
    )
    servicer = BridgeServicer(policy, mode)
    proto.add_EgodriverServiceServicer_to_server(servicer, server)  # type: ignore[no-untyped-call] # generated without types
    proto.add_CarlaVehicleServiceServicer_to_server(servicer, server)  # type: ignore[no-untyped-call] # likewise
    place = f"[{at.host}]" if ":" in at.host else at.host
    try:
        port = _bind(server, f"{place}:{at.port}", at)
    except RuntimeError as error:
        raise HostError(f"can't listen on {place}:{at.port}: {_bind_failure(at)}") from error
    server.start()
    try:
        yield f"grpc://{place}:{port}"
    finally:
        server.stop(_GRACE_S).wait()
        policy.close()


def _bind(server: grpc.Server, address: str, at: Listening) -> int:
    if not at.certificate:
        return int(server.add_insecure_port(address))
    pair = read_pair(at.certificate, at.key)
    return int(server.add_secure_port(address, grpc.ssl_server_credentials([pair])))


def _bind_failure(at: Listening) -> str:
    """Return why a place can't be listened on, with the remedy: gRPC doesn't say it."""
    try:
        family, kind, protocol, _, address = resolve(
            at.host, at.port, socket.SOCK_STREAM, socket.AI_PASSIVE
        )[0]
        with socket.socket(family, kind, protocol) as tried:
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind(address)
            tried.listen()
    except HostError as error:
        return f"{error}; give another --host"
    except OSError as error:
        is_port = error.errno in (errno.EADDRINUSE, errno.EACCES)
        return f"{error.strerror}; give another {'--port' if is_port else '--host'}"
    return "gRPC gives no reason; give another --port or --host"
