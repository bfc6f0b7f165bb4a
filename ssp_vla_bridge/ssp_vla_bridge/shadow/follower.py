"""From a stream of frames and VUT states to requests: the same rule as for a bag, while it runs."""

from __future__ import annotations

from bisect import insort
from dataclasses import dataclass, field, replace

from ssp_core.clock import NS_PER_S, seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_vla_bridge.core.request import CameraGeometry, Frame, Request
from ssp_vla_bridge.core.response import Response
from ssp_vla_bridge.core.task import TASK, DrivingTask
from ssp_vla_bridge.core.window import Preprocessing, choose, ego_history

# A camera's rate wavers; a frame that comes so much too early still counts as due.
_EARLY_NS = NS_PER_S // 100
# A stamp that goes back by more than this is another session or a replay that begins again.
_BACK_NS = NS_PER_S // 2


@dataclass
class Follower:
    """Keeps what a request may need of the last seconds; times are those of the session's clock.

    Args:
        model: name on the topics, part of the requests' ids.
        period_ns: between two requests, ns.
        rules: which frames and ego samples a request holds.
        carries_previous: a request holds the answer to the one before.
        task: what is asked.
    """

    model: str
    period_ns: int
    rules: Preprocessing
    carries_previous: bool = False
    task: DrivingTask = TASK
    camera: CameraGeometry | None = None
    _frames: list[Frame] = field(default_factory=list)
    _states: list[ObjectState] = field(default_factory=list)
    _asked_ns: int | None = None
    _previous: Response | None = None
    _open: dict[str, Request] = field(default_factory=dict)
    _of_before: set[str] = field(default_factory=set)  # open ones from before time began anew

    def state(self, state: ObjectState) -> None:
        """A state of the VUT came, in whatever order."""
        self._begin_anew(state.stamp_ns, self._states[-1].stamp_ns if self._states else None)
        insort(self._states, state, key=lambda one: one.stamp_ns)
        keep_ns = seconds_to_ns(self.rules.history_s + self.rules.state_age_s + 1.0)
        oldest_ns = self._states[-1].stamp_ns - keep_ns
        while self._states[0].stamp_ns < oldest_ns:
            del self._states[0]

    def frame(self, frame: Frame) -> bool:
        """A frame came; True when a request about it is due."""
        newest_ns = self._frames[-1].stamp_ns if self._frames else None
        self._begin_anew(frame.stamp_ns, newest_ns)
        if self._frames and frame.stamp_ns <= self._frames[-1].stamp_ns:
            return False  # late or twice: a request is about the newest
        self._frames.append(frame)
        oldest_ns = frame.stamp_ns - seconds_to_ns(self.rules.frame_span_s)
        while self._frames[0].stamp_ns < oldest_ns:
            del self._frames[0]
        asked_ns = self._asked_ns
        return asked_ns is None or frame.stamp_ns >= asked_ns + self.period_ns - _EARLY_NS

    def request(self) -> Request:
        """The request about the newest frame, which counts as asked from now on.

        Raises:
            ValueError: no frame has come.
        """
        if not self._frames:
            raise ValueError("there is no frame to ask about")
        stamps_ns = [frame.stamp_ns for frame in self._frames]
        now_ns = self._asked_ns = stamps_ns[-1]
        chosen = choose(stamps_ns, len(stamps_ns) - 1, self.rules)
        states_ns = [state.stamp_ns for state in self._states]
        history = ego_history(states_ns, self._states.__getitem__, now_ns, self.rules)
        request = Request(
            request_id=f"shadow-{self.model}-{now_ns}",
            stamp_ns=now_ns,
            frames=tuple(self._frames[i] for i in chosen),
            camera=self.camera,
            history=history,
            ego_provenance="measured" if history else "unknown",
            task=self.task,
            previous=self._previous if self.carries_previous else None,
        )
        self._open[request.request_id] = request
        return request

    def waits_for(self, request_id: str) -> bool:
        """True while a request of this follower's own has no answer."""
        return request_id in self._open

    def answered(self, response: Response) -> Response:
        """What came of a request; a failed one leaves nothing to carry on.

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
        self._asked_ns = self._previous = None
        self._of_before.update(self._open)


def _sight(request: Request) -> dict[str, object]:
    return {
        "frames_ns": [frame.stamp_ns for frame in request.frames],
        "history_s": round(-request.history[0].t_s, 3) if request.history else 0.0,
        "ego": request.ego_provenance,
        "previous": request.previous.request_id if request.previous is not None else "",
    }
