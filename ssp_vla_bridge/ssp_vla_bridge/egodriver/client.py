"""A policy behind an EgodriverService as the driver of the VUT.

Per question: frames, then egomotion, then route, each acknowledged, then ``drive``. Ground truth,
scene and renderer data are never sent.
"""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Callable, Sequence
from typing import Any

import grpc  # type: ignore[import-untyped] # has no types
from carla_driver_interface import protocol as proto
from carla_driver_interface.contract import (
    CONTRACT_REVISION,
    LEGACY_REVISION,
    SUPPORTED_REVISIONS,
    ContractError,
    contract_metadata,
    read_revision,
)

from ssp_core import console
from ssp_core.clock import seconds_to_ns
from ssp_core.errors import PeerError, SspError
from ssp_core.geometry import Pose2
from ssp_core.world.driver import (
    Answer,
    GivenAnswer,
    LatencyParts,
    Question,
    Raw,
    RecordedAnswer,
    repeated_answer,
)
from ssp_vla_bridge.driving.driver import geometry_of_run
from ssp_vla_bridge.egodriver import exact, wire
from ssp_vla_bridge.egodriver.channel import MOST_BYTES, open_channel
from ssp_vla_bridge.egodriver.options import HISTORY_S, EgodriverOptions

# Greatest age of what was seen between two questions and is sent.
_KEPT_S = 10.0
# For the end of a session, which an abort waits for.
_CLOSE_S = 2.0
_WORDS = 300
# What was left out of whose answers, which is said once.
_TOLD: set[tuple[str, str]] = set()
_BEFORE_REVISIONS = "-carla-driver-interface-1."
# gRPC's own words; a policy that runs out of memory has the same code.
_LARGER_THAN_MAX = "Received message larger than max"
ENDED = "it ended the session (terminate_session)"
CLOSED = "its connection was closed"
GIVEN_UP = "it was given up while it was loaded"
# Between two looks at whether an answer is still wanted.
_LOOK_S = 0.2


class CallFailedError(PeerError):
    """A call of the service that failed.

    Attributes:
        code: gRPC's.
        is_too_large: an answer came, and was larger than a message may be.
    """

    def __init__(self, call: str, code: grpc.StatusCode, details: str, within: str) -> None:
        self.code = code
        exhausted = code is grpc.StatusCode.RESOURCE_EXHAUSTED
        self.is_too_large = exhausted and _LARGER_THAN_MAX in (details or "")
        words = " ".join(console.visible(details or "").split())[:_WORDS]
        if code is grpc.StatusCode.DEADLINE_EXCEEDED:
            super().__init__(f"gave no answer to {call} within {within}")
        else:
            super().__init__(f"{call} failed: {code.name}: {words}")


class _Budget:
    """The wall time that calls have together.

    Args:
        limit_s: of all of them.
        what: they are, for messages; empty: there is one alone.
    """

    def __init__(self, limit_s: float, what: str = "") -> None:
        self._limit_s, self._what = limit_s, what
        self._begin_s = time.perf_counter()
        self._took_s: dict[str, float] = {}

    @property
    def left_s(self) -> float:
        """Time that is left of it; not positive where it is used up."""
        return self._limit_s - (time.perf_counter() - self._begin_s)

    def took(self, call: str, took_s: float) -> None:
        """Count the time that a call took."""
        self._took_s[call] = self._took_s.get(call, 0.0) + took_s

    def exceeded(self, call: str) -> str:
        """Return what a call exceeded, and which other one took the most of it."""
        text = f"its deadline_s of {self._limit_s:g} s{self._what}"
        for name, took_s in self._took_s.items():
            if name != call and took_s > self._limit_s / 2:
                text += f", most of which {name} took"
        return text


class EgodriverDriver:
    """A policy behind an EgodriverService, which drives one run in one session.

    Args:
        name: of the driver.
        options: of the connection.
        recorded: answers of a run before, which it repeats without a connection; None: it is asked.
        is_wanted: tells, while its server is looked for, whether it is still waited for.

    Attributes:
        problem: why it can't be asked; empty: it can.
        version: of the policy, as it says.
        revision: of the contract that its server speaks.
    """

    privileged = False
    frame_span_s = _KEPT_S
    history_s = HISTORY_S

    def __init__(
        self,
        name: str,
        options: EgodriverOptions,
        recorded: Sequence[RecordedAnswer] | None = None,
        is_wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        self._name, self._options, self._recorded = name, options, recorded
        self.problem, self.version, self.revision = "", "", 0
        self._channel: grpc.Channel | None = None
        self._session = ""
        self._origin = Pose2(0.0, 0.0, 0.0)
        self._last_ns: int | None = None
        self._is_exact = False
        self._budget = _Budget(options.deadline_s)
        if recorded is not None:
            return
        try:
            self._channel = open_channel(options)
            self._stub = proto.EgodriverServiceStub(self._channel)  # type: ignore[no-untyped-call] # generated without types
            self._negotiate(is_wanted)
        except (SspError, ContractError) as error:
            self.problem = str(error)

    def _negotiate(self, is_wanted: Callable[[], bool]) -> None:
        version, metadata = self._call("get_version", proto.Empty(), is_wanted=is_wanted)
        self.version = console.visible(version.version_id)[:_WORDS]
        try:
            self.revision = read_revision(metadata, self._undeclared())
        except ContractError as error:
            revisions = ", ".join(map(str, SUPPORTED_REVISIONS))
            raise PeerError(
                f"the server's {error}: revisions {revisions} are spoken here"
            ) from error
        self._is_exact = any(key == exact.EXACT for key, _ in metadata)

    def _undeclared(self) -> int:
        """Return the revision of a server that declares none.

        The package declares one from 2.0 on, and names itself in its version before; everything
        else that declares none is AlpaSim's own, and speaks its convention.
        """
        if self._options.revision is not None:
            return self._options.revision
        return LEGACY_REVISION if _BEFORE_REVISIONS in self.version else CONTRACT_REVISION

    def choose(self, stamps_ns: Sequence[int]) -> list[int]:
        """Return the indices of the frames that weren't sent yet, rising; the newest is last."""
        newest = len(stamps_ns) - 1
        before_ns = self._last_ns
        if before_ns is None:
            before_ns = stamps_ns[newest] - seconds_to_ns(HISTORY_S) - 1
        return [*(i for i in range(newest) if stamps_ns[i] > before_ns), newest]

    def give(self, question: Question) -> GivenAnswer:
        """Answer one question, or say why the driver ended.

        Raises:
            NotRecordedError: a recorded run asks another question than it did.
        """
        if self._recorded is not None:
            # The frames of the next question are chosen as they were.
            self._last_ns = question.stamp_ns
            return repeated_answer(self._recorded, question)
        if self.problem:
            return GivenAnswer(None, ended=f"it can't be loaded: {self.problem}")
        if self._channel is None:
            return GivenAnswer(None, ended=CLOSED)
        begin_s = time.perf_counter()
        self._budget = _Budget(self._options.deadline_s, " for the whole question")
        try:
            if not self._session:
                self._start(question)
                # A policy that loads its model for a session isn't slow to answer.
                begin_s = time.perf_counter()
            self._observe(question)
            answer, parsing_s = self._drive(question)
        except CallFailedError as error:
            return GivenAnswer(None, _since(begin_s), str(error))
        if isinstance(answer, str):
            return GivenAnswer(None, _since(begin_s), answer)
        return GivenAnswer(answer, _since(begin_s, parsing_s))

    def _observe(self, question: Question) -> None:
        """Send what was seen since the last question."""
        if question.camera is None:
            raise ValueError("a driver that sees was asked without a camera")
        for frame in question.frames:
            exposure_s = question.camera.exposure_time_s
            name = self._options.camera
            message = wire.image(self._session, name, frame.stamp_ns, exposure_s, frame.jpeg)
            self._call("submit_image_observation", message)
        before_ns = question.stamp_ns - seconds_to_ns(HISTORY_S) - 1
        after_us = wire.micros(before_ns if self._last_ns is None else self._last_ns)
        motion = wire.egomotion(self._session, question, self._origin, after_us)
        metadata = [(exact.MOTION, exact.pack_motion(question.history))] if self._is_exact else []
        self._call("submit_egomotion_observation", motion, metadata)
        self._call("submit_route", wire.route(self._session, question))
        self._last_ns = question.stamp_ns

    def _start(self, question: Question) -> None:
        if question.camera is None:
            raise ValueError("a driver that sees was asked without a camera")
        self._origin = question.pose
        request = proto.DriveSessionRequest(random_seed=question.seed)
        declared = wire.available_camera(question.camera, self._options.camera, self.revision)
        request.rollout_spec.vehicle.available_cameras.append(declared)
        metadata: list[tuple[str, str | bytes]] = [*contract_metadata(self.revision)]
        if self._is_exact:
            geometry = geometry_of_run(question.camera)
            metadata.append((exact.CAMERA, exact.pack_camera(geometry)))
        # A name that tells nothing: of an event and its twin, or when a start is driven again.
        request.session_uuid = str(uuid.uuid4())
        # Known before the call: a start that is given up may yet leave a session to close.
        self._session = request.session_uuid
        try:
            self._call("start_session", request, metadata)
        except CallFailedError as error:
            if error.code is grpc.StatusCode.ALREADY_EXISTS:
                self._session = ""  # another one's
            raise

    def _drive(self, question: Question) -> tuple[Answer | str, float]:
        """Return the answer, or why the driver ended, and how long reading it took."""
        now_us = wire.micros(question.stamp_ns)
        request = proto.DriveRequest(
            session_uuid=self._session,
            time_now_us=now_us,
            time_query_us=now_us + round(self._options.control_step_s * 1e6),
        )
        try:
            response, _ = self._call("drive", request)
        except CallFailedError as error:
            # That an answer did come, and was too large, is known by gRPC's own words alone.
            if not error.is_too_large:
                raise
            refused = f"an answer that isn't taken, of more than {MOST_BYTES >> 20} MiB: {error}"
            return Answer(None, "", refused, self._raw()), 0.0
        begin_s = time.perf_counter()
        if response.terminate_session:
            return ENDED, 0.0
        answer = self._read(question, response)
        return answer, time.perf_counter() - begin_s

    def _read(self, question: Question, response: proto.DriveResponse) -> Answer:
        """Return an answer as the session takes it."""
        samples = response.debug_info.sampled_trajectories
        sizes = [len(response.trajectory.poses), *(len(one.poses) for one in samples)]
        if len(samples) > wire.MOST_SAMPLES:
            refused = f"{len(samples)} samples, at most {wire.MOST_SAMPLES}"
            return Answer(None, "", refused, self._raw())
        if max(sizes) > wire.MOST_POINTS:
            refused = f"{max(sizes)} points, at most {wire.MOST_POINTS}"
            return Answer(None, "", refused, self._raw())
        if 3 * sum(sizes) > wire.MOST_NUMBERS:
            refused = f"{sum(sizes)} points in all, at most {wire.MOST_NUMBERS // 3}"
            return Answer(None, "", refused, self._raw())
        here = wire.local_pose(self._origin, question.pose)
        now_us = wire.micros(question.stamp_ns)
        plan, refused = wire.trajectory_of(response.trajectory, here, now_us), "not_ready"
        debug = wire.debug_text(response.debug_info.unstructured_debug_info)
        text, left_out = debug.text, debug.left_out
        if self._is_exact and debug.value is not None and debug.value.get("schema") == exact.SCHEMA:
            try:
                plan, why = exact.plan_in(debug.value, plan)
            except ValueError as error:
                return Answer(None, "", str(error), self._raw())
            refused = console.visible(why) or refused
            theirs = console.visible(str(debug.value.get("left_out") or ""))[:_WORDS]
            left_out = theirs or left_out
        raw = self._raw(samples, left_out)
        return Answer(plan, text, "" if plan is not None else refused, raw)

    def _raw(self, samples: Sequence[proto.Trajectory] = (), left_out: str = "") -> Raw:
        decoding: dict[str, Any] = {"revision": self.revision}
        if left_out:
            decoding["debug_info_left_out"] = left_out
        if left_out and (self._name, left_out) not in _TOLD:
            _TOLD.add((self._name, left_out))
            console.note(f"{self._name}: the text beside its plans is left out: {left_out}")
        arrays = wire.sampled_arrays(samples)
        return Raw(self.version, arrays, json.dumps(decoding, sort_keys=True))

    def _call(
        self,
        call: str,
        message: Any,
        metadata: Sequence[tuple[str, str | bytes]] = (),
        is_wanted: Callable[[], bool] | None = None,
    ) -> tuple[Any, Sequence[tuple[str, str | bytes]]]:
        """Return the answer to a call, and the metadata that came before it.

        Args:
            call: name of the method.
            message: of the call.
            metadata: that goes with it.
            is_wanted: tells whether the answer is still waited for; None: it is.

        Raises:
            CallFailedError: it failed, took longer than what is left of the deadline, or was given
                up.
        """
        method: Any = getattr(self._stub, call)
        budget, begin_s = self._budget, time.perf_counter()
        left_s = budget.left_s
        if left_s <= 0.0:
            late = grpc.StatusCode.DEADLINE_EXCEEDED
            raise CallFailedError(call, late, "", budget.exceeded(call))
        try:
            if is_wanted is None:
                answer, grpc_call = method.with_call(
                    message, timeout=left_s, metadata=list(metadata)
                )
            else:
                grpc_call = method.future(message, timeout=left_s, metadata=list(metadata))
                answer = _awaited(call, grpc_call, is_wanted)
        except grpc.RpcError as error:
            exceeded = budget.exceeded(call)
            raise CallFailedError(call, error.code(), error.details(), exceeded) from error
        except ValueError as error:
            # So says gRPC of a channel that was closed meanwhile, by an abort.
            raise CallFailedError(call, grpc.StatusCode.CANCELLED, CLOSED, "") from error
        budget.took(call, time.perf_counter() - begin_s)
        return answer, grpc_call.initial_metadata() or ()

    def close(self) -> None:
        """End the session and the connection; a server without an answer isn't waited for."""
        channel, session = self._channel, self._session
        self._channel, self._session = None, ""
        if channel is None:
            return
        self._budget = _Budget(min(self._options.deadline_s, _CLOSE_S))
        try:
            if session:
                self._call("close_session", proto.DriveSessionCloseRequest(session_uuid=session))
        except CallFailedError as error:
            console.note(f"{self._name}: {error}")
        finally:
            channel.close()


def _awaited(call: str, pending: Any, is_wanted: Callable[[], bool]) -> Any:
    """Return the answer to a call that is under way, or give it up once it isn't wanted."""
    while True:
        try:
            return pending.result(timeout=_LOOK_S)
        except grpc.FutureTimeoutError:
            if not is_wanted():
                pending.cancel()
                raise CallFailedError(call, grpc.StatusCode.CANCELLED, GIVEN_UP, "") from None


def _since(begin_s: float, parsing_s: float = 0.0) -> LatencyParts:
    total_s = time.perf_counter() - begin_s
    return LatencyParts(seconds_to_ns(total_s), 0, seconds_to_ns(min(parsing_s, total_s)))
