"""One of our bridges as a policy of the EgodriverService: its sessions, and how it is asked.

A session has a seat, with a model in a process of its own. All that begins and ends a seat stands
in ``BridgePolicy``: a seat is taken before its model is loaded, and is free once its process has
ended. A session without a waiting client, since its client gave up, closed it or was idle
while others wanted its place, ends at once, also while its model loads or answers.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from carla_driver_interface.driver import (
    BaseDriver,
    CameraFrame,
    DriveContext,
    DriveResult,
    SensorFrame,
    SessionState,
)
from carla_driver_interface.geometry import Trajectory as RigTrajectory

from ssp_core.world.driver import Answer
from ssp_vla_bridge.driving.driver import BridgeDriver, DriverModel, history_by
from ssp_vla_bridge.egodriver import exact, wire
from ssp_vla_bridge.egodriver.options import FORWARD_CAMERA
from ssp_vla_bridge.messages import CameraGeometry, EgoSample, Frame, Request
from ssp_vla_bridge.window import choose

# Frames of a session that are kept: so many at least, and so many for each that a request holds,
# since a client may send them faster.
_KEPT_FRAMES, _PER_FRAME = 16, 4
# And no more than this of them, but for the newest.
_MOST_FRAME_BYTES = 128 << 20
# Poses of a session that are kept; twice as many before the older ones are left out.
_KEPT_POSES = 1000
# An older newest pose says nothing of how the vehicle moves now.
_POSE_AGE_US = 300_000
_JPEG = b"\xff\xd8"
_JPEG_QUALITY = 95
# A session without a call for so long gives its place to a new one: its client is gone.
IDLE_S = 600.0
EXISTS = "there is a session of this name"
# Sessions that end with their server have this long for it.
_END_S = 10.0


@dataclass
class Seat:
    """One session of a bridge.

    Args:
        is_waited_for: tells, while its model loads, whether its client waits for it.
        sent_camera: to the last bit, from a client of ours; None: it is none of ours.
        driver: its model, in a process of its own; None: it isn't loaded yet.
        camera: name of the camera that it sees by.
        geometry: of the camera.
        motion: to the last bit, from a client of ours; None: it sent none.
        lacks_speeds: its client sent poses without their dynamic states, which the package takes
            for those of a standing vehicle: its motion is unknown.
        used_s: time of the last call, monotonic.
        is_leaving: it gives its place to a new one, and to no other.
        is_over: it ends, or will as soon as its model is loaded.
    """

    is_waited_for: Callable[[], bool]
    sent_camera: bytes | None = None
    driver: BridgeDriver | None = None
    camera: str = ""
    geometry: CameraGeometry | None = None
    motion: bytes | None = None
    lacks_speeds: bool = False
    used_s: float = field(default_factory=time.monotonic)
    is_leaving: bool = False
    is_over: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def is_wanted(self) -> bool:
        """Tell whether its model, which loads, is still waited for."""
        return not self.is_over and self.is_waited_for()

    @property
    def is_idle(self) -> bool:
        """Tell whether its client is gone."""
        is_ready = self.driver is not None and not self.lock.locked()
        is_here = is_ready and not (self.is_over or self.is_leaving)
        return is_here and time.monotonic() - self.used_s >= IDLE_S


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
        self.most_sessions = most_sessions
        self._model, self._camera = model, camera
        # Whoever holds it waits for nothing.
        self._lock = threading.Condition()
        self._seats: dict[str, Seat] = {}
        self._is_over = False
        self._here = threading.local()

    def seat(self, session: str) -> Seat | None:
        """Return a session's seat; None: there is no such session."""
        return self._seats.get(session)

    @property
    def seat_count(self) -> int:
        """Seats that are taken: those of sessions, and those whose processes begin or end."""
        return len(self._seats)

    def take(self, session: str, seat: Seat) -> tuple[str, str]:
        """Take a seat for a session that begins.

        Returns:
            Why there is none, or the empty text; the idle session that has to be closed before this
            is called again, or the empty text.
        """
        with self._lock:
            if session in self._seats:
                return EXISTS, ""
            if self._is_over:
                return "the server ends", ""
            if len(self._seats) < self.most_sessions:
                self._seats[session] = seat
                return "", ""
            idle = [(one.used_s, uuid) for uuid, one in self._seats.items() if one.is_idle]
            if not idle:
                return f"there are {self.most_sessions} sessions already, which is the most", ""
            leaves = min(idle)[1]
            self._seats[leaves].is_leaving = True
        return "", leaves

    def leave(self, session: str) -> None:
        """Free the seat of a session that didn't begin."""
        with self._lock:
            self._seats.pop(session, None)
            self._lock.notify_all()

    def on_session_start(self, session: SessionState) -> None:
        """Load the model for a session, whose seat is taken.

        Raises:
            ValueError: its cameras aren't what the bridge can see by, the model can't be loaded, or
                the session was given up meanwhile.
        """
        seat = self._seats[session.uuid]
        seat.camera = self._choose_camera(sorted(session.cameras))
        try:
            seat.geometry = wire.geometry_of_camera(session.cameras[seat.camera])
        except ValueError as error:
            raise ValueError(f"the camera {seat.camera!r} {error}") from error
        if seat.sent_camera is not None:
            seat.geometry = exact.unpack_camera(seat.sent_camera, seat.geometry)
        driver = BridgeDriver(self._model, is_wanted=lambda: seat.is_wanted)
        with self._lock:
            is_over = seat.is_over
            if not is_over and not driver.problem:
                seat.driver, seat.used_s = driver, time.monotonic()
        if driver.problem:
            raise ValueError(f"the model can't be loaded: {driver.problem}")
        if is_over:
            driver.close()
            raise ValueError("the session was closed while its model was loaded")

    def _choose_camera(self, names: list[str]) -> str:
        camera = self._camera or (FORWARD_CAMERA if len(names) != 1 else names[0])
        if camera not in names:
            raise ValueError(
                f"no camera {camera!r} is declared, but {', '.join(names) or 'none'}; "
                "ssp driver serve --camera names the one to see by"
            )
        return camera

    def on_session_close(self, session: SessionState) -> None:
        """End a session's model, also one that answers; one that loads ends by itself."""
        self._end(session.uuid)

    def _end(self, uuid: str) -> None:
        with self._lock:
            seat = self._seats.get(uuid)
            if seat is None or seat.is_over:
                return
            seat.is_over, driver = True, seat.driver
        if driver is None:
            return
        driver.interrupt()
        with seat.lock:
            driver.close()
        self.leave(uuid)

    def close(self) -> None:
        """End all sessions; none begins any more."""
        with self._lock:
            self._is_over = True
            uuids = list(self._seats)
        for uuid in uuids:
            self._end(uuid)
        with self._lock:
            self._lock.wait_for(lambda: not self._seats, _END_S)

    def on_frame(self, session: SessionState, frame: SensorFrame) -> None:
        """Keep the frames of the session's camera, so many bytes at most, and no others."""
        seat = self._used(session)
        with session.lock:
            if seat is None or frame.logical_id != seat.camera:
                session.frame_history.pop(frame.logical_id, None)
                return
            frames = session.frame_history[seat.camera]
            while len(frames) > 1 and sum(map(_bytes_of, frames)) > _MOST_FRAME_BYTES:
                del frames[0]

    def on_egomotion(self, session: SessionState, new_poses: RigTrajectory) -> None:  # noqa: ARG002 # of the package
        """Keep the newest poses."""
        self._used(session)
        with session.lock:
            poses, states = session.ego_trajectory, session.dynamic_states
            if len(states) > 2 * _KEPT_POSES:
                del poses.timestamps_us[:-_KEPT_POSES]
                del poses.poses[:-_KEPT_POSES]
                del states[:-_KEPT_POSES]

    def on_route(self, session: SessionState) -> None:
        """Leave the route out: no bridge is asked with one."""
        self._used(session)
        session.route_waypoints_in_rig = np.zeros((0, 3))

    def on_ground_truth(self, session: SessionState) -> None:
        """Leave the truth out."""
        self._used(session)
        session.ground_truth_in_rig = None

    def _used(self, session: SessionState) -> Seat | None:
        seat = self.seat(session.uuid)
        if seat is not None:
            seat.used_s = time.monotonic()
        return seat

    @property
    def last_answer(self) -> Answer | None:
        """Answer of the call that this thread handles; None: it has none."""
        answer: Answer | None = getattr(self._here, "answer", None)
        return answer

    def drive(self, ctx: DriveContext) -> DriveResult:
        """Ask the bridge; what isn't a plan is an empty one.

        Raises:
            RuntimeError: the model ended, with its reason.
        """
        self._here.answer = None
        seat = self._used(ctx.session)
        if seat is None:
            raise RuntimeError("the session is over")
        with seat.lock:
            driver = seat.driver
            if driver is None or seat.is_over:
                raise RuntimeError("the session hasn't begun, or is over")
            request = self._request(seat, ctx)
            if request is None:
                return DriveResult(RigTrajectory.empty())
            reply = driver.ask(request)
            seat.used_s = time.monotonic()
        answer = reply.answer
        if answer is None:
            raise RuntimeError(reply.ended)
        self._here.answer = answer
        plan = answer.trajectory
        if plan is None or answer.refused or not _is_sendable(plan.t_s, plan.x_m, plan.y_m):
            return DriveResult(RigTrajectory.empty())
        return DriveResult(wire.plan_in_rig(plan, ctx.time_now_us))

    def _request(self, seat: Seat, ctx: DriveContext) -> Request | None:
        """Return the request of one call; None while no frame or motion was sent."""
        session, now_us, rules = ctx.session, ctx.time_now_us, self._model.rules
        with session.lock:
            frames = [
                one
                for one in session.frame_history.get(seat.camera, ())
                if isinstance(one, CameraFrame) and one.timestamp_us <= now_us
            ]
            times = list(session.ego_trajectory.timestamps_us)
            poses = list(session.ego_trajectory.poses)
            states = list(session.dynamic_states)
        if not frames or not times:
            return None
        if times[-1] > now_us:
            ahead_s = (times[-1] - now_us) / 1e6
            raise ValueError(f"its newest pose is {ahead_s:g} s after time_now_us")
        stamps_ns = [one.timestamp_us * 1000 for one in frames]
        indices = choose(stamps_ns, len(frames) - 1, rules)
        samples: tuple[Any, ...] = ()
        if now_us - times[-1] <= _POSE_AGE_US and not seat.lacks_speeds:
            first = max(0, len(times) - _KEPT_POSES)
            samples = wire.samples_of(times[first:], poses[first:], states[first:], times[-1])
            if seat.motion is not None:
                samples = exact.unpack_motion(seat.motion, samples)
        history: tuple[EgoSample, ...] = history_by(samples, rules) if samples else ()
        return Request(
            request_id=str(session.drive_count + 1),
            stamp_ns=now_us * 1000,
            frames=tuple(Frame(stamps_ns[i], _jpeg(frames[i].image_bytes)) for i in indices),
            camera=seat.geometry,
            history=history,
            ego_provenance="measured" if history else "unknown",
            task=self._model.task,
        )


def _bytes_of(frame: SensorFrame) -> int:
    return len(frame.image_bytes if isinstance(frame, CameraFrame) else frame.points_xyzi)


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
