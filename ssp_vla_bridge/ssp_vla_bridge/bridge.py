"""The decisions of a bridge: next request, state of its backend, plan of shadow mode."""

from __future__ import annotations

from bisect import insort
from collections import Counter, deque
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.node_interface import QOS, Level, Status
from ssp_vla_bridge.messages import (
    TASK,
    CameraGeometry,
    DrivingTask,
    ErrorCode,
    Frame,
    Request,
    Response,
)
from ssp_vla_bridge.window import Preprocessing, choose, ego_history


@dataclass(frozen=True)
class Ticket:
    """A request that was taken in, and when (ns, steady clock)."""

    number: int
    request: Request
    received_ns: int


class RequestQueue:
    """A bounded queue whose requests are answered exactly once: by the worker or by a deadline.

    It is not locked: a caller that shares it between threads holds a lock around each call.

    Args:
        limit: requests that may wait, besides the one that is worked on.
        timeout_ns: from taking in to answering, ns.

    Raises:
        ValueError: limit or timeout is not positive.
    """

    def __init__(self, limit: int, timeout_ns: int) -> None:
        if limit < 1 or timeout_ns < 1:
            raise ValueError(f"limit {limit} and timeout {timeout_ns} ns must be positive")
        self._limit = limit
        self._timeout_ns = timeout_ns
        self._count = 0
        self._waiting: deque[Ticket] = deque()
        self._open: dict[int, Ticket] = {}

    def offer(self, request: Request, now_ns: int) -> Ticket | None:
        """Take a request in; return None when the queue is full."""
        if len(self._waiting) >= self._limit:
            return None
        self._count += 1
        ticket = Ticket(self._count, request, now_ns)
        self._waiting.append(ticket)
        self._open[ticket.number] = ticket
        return ticket

    @property
    def waiting(self) -> int:
        """Requests in the queue."""
        return len(self._waiting)

    @property
    def busy(self) -> bool:
        """Tell whether a request is still to be answered."""
        return bool(self._open)

    def take(self) -> Ticket | None:
        """Return the oldest waiting request, None when there is none."""
        return self._waiting.popleft() if self._waiting else None

    def finish(self, ticket: Ticket) -> bool:
        """Tell whether this request is still to be answered; from now on it is not."""
        return self._open.pop(ticket.number, None) is not None

    def expire(self, now_ns: int) -> list[Ticket]:
        """Return the requests whose time has run out, oldest first; they count as answered."""
        late = [t for t in self._open.values() if now_ns - t.received_ns > self._timeout_ns]
        for ticket in late:
            del self._open[ticket.number]
        self._waiting = deque(t for t in self._waiting if t.number in self._open)
        return late


# Answers without a listener are kept up to this number.
MOST_HELD = 256
# A topic's queue holds so many: more at once would push one another out.
MOST_AT_ONCE = QOS["VLA"].depth
RELEASE_PERIOD_NS = NS_PER_S // 20
A = TypeVar("A")


class AnswerQueue(Generic[A]):
    """Answers in their order, each until a listener can receive it.

    Discovery isn't symmetric: a client that already reaches the bridge may not be reached yet, on a
    busy machine for seconds, and what is published meanwhile is lost.

    Args:
        worth_ns: how long an answer is worth something to the client that asked, ns.
    """

    def __init__(self, worth_ns: int) -> None:
        self._worth_ns = worth_ns
        self._queue: deque[tuple[int, A]] = deque(maxlen=MOST_HELD)
        # When those that were released last were, ns.
        self._released: deque[int] = deque(maxlen=MOST_AT_ONCE)

    def hold(self, answer: A, now_ns: int) -> bool:
        """Take an answer; return True when the oldest one gave way to it."""
        full = len(self._queue) == MOST_HELD
        self._queue.append((now_ns + self._worth_ns, answer))
        return full

    def release(self, has_listener: bool, now_ns: int) -> tuple[list[A], int]:
        """Take the answers out that are to be published now, and those that are too old.

        Args:
            has_listener: the publisher has one.
            now_ns: the steady clock, ns.

        Returns:
            The answers to publish, so many as a queue of the topic holds; how many were given up,
            since they are worth nothing any more.
        """
        given_up = 0
        while self._queue and self._queue[0][0] < now_ns:
            self._queue.popleft()
            given_up += 1
        answers: list[A] = []
        while has_listener and self._queue and self._has_room(now_ns):
            answers.append(self._queue.popleft()[1])
            self._released.append(now_ns)
        return answers, given_up

    def _has_room(self, now_ns: int) -> bool:
        is_full = len(self._released) == MOST_AT_ONCE
        return not is_full or now_ns - self._released[0] >= RELEASE_PERIOD_NS


# Latencies and errors of this many answers are looked at; an error counts for this long.
_WINDOW = 100
_RECENT_NS = 60 * NS_PER_S


@dataclass
class BridgeHealth:
    """Counts of one bridge; all times are of the steady clock, ns."""

    model: str
    model_id: str
    timeout_s: float
    answered: int = 0
    late: int = 0
    skipped: int = 0
    errors: Counter[ErrorCode] = field(default_factory=Counter)
    busy_since_ns: int | None = None
    _latencies_s: deque[float] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    _failed: deque[bool] = field(default_factory=lambda: deque(maxlen=3))
    _last_error: str = ""
    _last_error_ns: int = 0

    def see(self, code: int, message: str, latency_s: float, now_ns: int) -> None:
        """Count an answer that left, good or not."""
        if code == ErrorCode.NONE:
            self.answered += 1
            self._latencies_s.append(latency_s)
        else:
            self.errors[ErrorCode(code)] += 1
            self._last_error, self._last_error_ns = message, now_ns
        self._failed.append(code != ErrorCode.NONE)

    def status(self, waiting: int, now_ns: int) -> Status:
        """Return the bridge's health now."""
        level, message = self._assess(now_ns)
        values = [
            ("model", self.model_id),
            ("answered", str(self.answered)),
            ("waiting", str(waiting)),
            *((f"errors: {code.name.lower()}", str(n)) for code, n in sorted(self.errors.items())),
            ("answers that came too late", str(self.late)),
            ("frames passed over while busy", str(self.skipped)),
        ]
        if self._latencies_s:
            ordered = sorted(self._latencies_s)
            values += [
                ("latency, median [s]", f"{ordered[len(ordered) // 2]:.3f}"),
                ("latency, longest [s]", f"{ordered[-1]:.3f}"),
            ]
        name = f"ssp: vla_bridge {self.model}"
        return Status(name, f"vla_bridge_{self.model}", level, message, tuple(values))

    def _assess(self, now_ns: int) -> tuple[Level, str]:
        busy_s = 0.0 if self.busy_since_ns is None else ns_to_seconds(now_ns - self.busy_since_ns)
        if busy_s > self.timeout_s:
            return Level.ERROR, f"the model has been at one request for {busy_s:.0f} s"
        if len(self._failed) == self._failed.maxlen and all(self._failed):
            return Level.ERROR, f"no answer to the last requests: {self._last_error}"
        recent = self._last_error and now_ns - self._last_error_ns < _RECENT_NS
        if recent:
            return Level.WARN, f"an error in the last minute: {self._last_error}"
        if busy_s:
            return Level.OK, f"at work for {busy_s:.1f} s"
        return Level.OK, "ready" if not self.answered else "answering"


# A camera's rate wavers; a frame that comes so much too early still counts as due.
_EARLY_NS = NS_PER_S // 100
# A stamp that goes back by more than this is another session or a replay that begins again.
_BACK_NS = NS_PER_S // 2


@dataclass
class ShadowRequests:
    """Keeps what a request may need of the last seconds; times are those of the session's clock.

    Args:
        carries_previous: a request holds the answer to the one before.
    """

    model: str
    period_ns: int
    rules: Preprocessing
    carries_previous: bool = False
    task: DrivingTask = TASK
    camera: CameraGeometry | None = None
    _frames: list[Frame] = field(default_factory=list)
    _states: list[ObjectState] = field(default_factory=list)
    _request_ns: int | None = None
    _previous: Response | None = None
    _open: dict[str, Request] = field(default_factory=dict)
    _of_before: set[str] = field(default_factory=set)  # open ones from before time began anew

    def state(self, state: ObjectState) -> None:
        """Take a state of the VUT, in any order."""
        self._begin_anew(state.stamp_ns, self._states[-1].stamp_ns if self._states else None)
        insort(self._states, state, key=lambda one: one.stamp_ns)
        keep_ns = seconds_to_ns(self.rules.history_s + self.rules.state_age_s + 1.0)
        oldest_ns = self._states[-1].stamp_ns - keep_ns
        while self._states[0].stamp_ns < oldest_ns:
            del self._states[0]

    def frame(self, frame: Frame) -> bool:
        """Take a frame; return True when a request about it is due."""
        newest_ns = self._frames[-1].stamp_ns if self._frames else None
        self._begin_anew(frame.stamp_ns, newest_ns)
        if self._frames and frame.stamp_ns <= self._frames[-1].stamp_ns:
            return False  # late or twice: a request is about the newest
        self._frames.append(frame)
        oldest_ns = frame.stamp_ns - seconds_to_ns(self.rules.frame_span_s)
        while self._frames[0].stamp_ns < oldest_ns:
            del self._frames[0]
        asked_ns = self._request_ns
        return asked_ns is None or frame.stamp_ns >= asked_ns + self.period_ns - _EARLY_NS

    def request(self) -> Request:
        """Return the request about the newest frame, which counts as asked from now on.

        Raises:
            ValueError: no frame has come.
        """
        if not self._frames:
            raise ValueError("there is no frame to ask about")
        stamps_ns = [frame.stamp_ns for frame in self._frames]
        now_ns = self._request_ns = stamps_ns[-1]
        indices = choose(stamps_ns, len(stamps_ns) - 1, self.rules)
        states_ns = [state.stamp_ns for state in self._states]
        history = ego_history(states_ns, self._states.__getitem__, now_ns, self.rules)
        request = Request(
            request_id=f"shadow-{self.model}-{now_ns}",
            stamp_ns=now_ns,
            frames=tuple(self._frames[i] for i in indices),
            camera=self.camera,
            history=history,
            ego_provenance="measured" if history else "unknown",
            task=self.task,
            previous=self._previous if self.carries_previous else None,
        )
        self._open[request.request_id] = request
        return request

    def answered(self, response: Response) -> Response:
        """Take the outcome of a request; a failed one leaves nothing to carry on.

        Returns:
            The response, with what its request held among the decoding facts: no request of a
            shadow stands in a recording. One to somebody else's request as it is.
        """
        request = self._open.pop(response.request_id, None)
        if request is None:
            return response
        if response.request_id in self._of_before:
            self._of_before.discard(response.request_id)
        else:
            self._previous = None if response.error_code else response
        return replace(response, decoding={**response.decoding, "input": _sight(request)})

    def _begin_anew(self, stamp_ns: int, newest_ns: int | None) -> None:
        if newest_ns is None or stamp_ns > newest_ns - _BACK_NS:
            return
        self._frames.clear()
        self._states.clear()
        self._request_ns = self._previous = None
        self._of_before.update(self._open)


def _sight(request: Request) -> dict[str, object]:
    return {
        "frames_ns": [frame.stamp_ns for frame in request.frames],
        "history_s": round(-request.history[0].t_s, 3) if request.history else 0.0,
        "ego": request.ego_provenance,
        "previous": request.previous.request_id if request.previous is not None else "",
    }
