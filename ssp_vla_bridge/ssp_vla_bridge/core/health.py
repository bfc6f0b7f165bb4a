"""What a bridge did so far, and its health for ``/diagnostics``."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field

from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.node_interface import Level, Status
from ssp_vla_bridge.core.response import ErrorCode

# Latencies and errors of this many answers are looked at; an error counts for this long.
_WINDOW = 100
_RECENT_NS = 60 * NS_PER_S


@dataclass
class BridgeHealth:
    """Counts of one bridge; all times are of the steady clock, ns.

    Args:
        model: name on the topics.
        model_id: exact model and version.
        timeout_s: that a request has.
    """

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
        """An answer left, good or not."""
        if code == ErrorCode.NONE:
            self.answered += 1
            self._latencies_s.append(latency_s)
        else:
            self.errors[ErrorCode(code)] += 1
            self._last_error, self._last_error_ns = message, now_ns
        self._failed.append(code != ErrorCode.NONE)

    def status(self, waiting: int, now_ns: int) -> Status:
        """The bridge's health now.

        Args:
            waiting: requests in the queue.
            now_ns: steady clock.
        """
        level, message = self._judged(now_ns)
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

    def _judged(self, now_ns: int) -> tuple[Level, str]:
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
