"""The time that a session's processes were kept waiting for a processor, as the kernel counts it.

A process that the machine kept waiting seems silent, slow or off in time, and so does the object
that it leads: then the machine is the reason, and no object is blamed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

from ssp_core import names
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.safety.liveness import SILENCES
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.session.run_script import RunOutcome

# A wait counts that ended so long before a limit was passed, and the limit, or after it.
WINDOW_S = 1.0
# One wait of this share of a limit, and what is usual besides, passes the limit.
SHARE = 0.8
_OF_WAITING = SILENCES | {
    SafetyCode.STATE_STALE,
    SafetyCode.HEARTBEAT_LOST,
    SafetyCode.ACK_MISSING,
    SafetyCode.CLOCK_OFFSET,
    SafetyCode.LINK_DELAY,
    SafetyCode.CONNECTION_LOST,
}
_MOST_LOOKS = 400


def waited_ns(pid: int) -> int | None:
    """Give how long the main thread of a process has waited for a processor since its start, ns.

    None where the kernel doesn't say (/proc/PID/schedstat). A wait counts once it is over.
    """
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        return None


class ProcessorWaits:
    """Waits of each node's process over time. Reads no clock: times are of the steady clock, ns."""

    def __init__(self) -> None:
        self._looks: dict[str, deque[tuple[int, int]]] = {}

    def look(self, waits_ns: Mapping[str, int | None], steady_ns: int) -> None:
        """Take the waits of the nodes since their start."""
        for node, wait_ns in waits_ns.items():
            if wait_ns is not None:
                looks = self._looks.setdefault(node, deque(maxlen=_MOST_LOOKS))
                looks.append((steady_ns, wait_ns))

    def longest_s(self, node: str, since_ns: int, until_ns: int) -> float:
        """Give how long one wait of a node lasted at least, of those that ended between two times.

        Of what a node waited more than two looks lie apart, the rest is one wait that had begun
        before. Many short ones, as each busy machine has them, make no long one.
        """
        longest_ns = 0
        for (before_ns, before), (at_ns, wait) in pairwise(self._looks.get(node, ())):
            if since_ns <= at_ns <= until_ns:
                longest_ns = max(longest_ns, (wait - before) - (at_ns - before_ns))
        return ns_to_seconds(longest_ns)

    def too_busy(self, code: int, who: str, limit_s: float, at_ns: int) -> str:
        """Say that the machine kept those waiting who seem silent, slow or off in time.

        Args:
            code: of the first safety event of the run.
            who: object or node of it.
            limit_s: that was passed.
            at_ns: when it was heard.

        Returns:
            The reason; empty where no node of theirs waited for so long that it could be one.
        """
        if code not in _OF_WAITING or limit_s <= 0.0:  # what counts losses is no time
            return ""
        since_ns = at_ns - seconds_to_ns(limit_s + WINDOW_S)
        until_ns = at_ns + seconds_to_ns(WINDOW_S)
        name = MEANINGS[SafetyCode(code)].limit_name
        for node in _nodes_of(who):
            waited_s = self.longest_s(node, since_ns, until_ns)
            if waited_s > SHARE * limit_s:
                return (
                    f"{MEANINGS[SafetyCode.OVERRUN].limit_name}: the machine was too busy: {node} "
                    f"waited {waited_s:.2f} s for a processor (instead of {name} of {who})"
                )
        return ""


def _nodes_of(who: str) -> tuple[str, ...]:
    """Return the nodes whose waits let an object or node seem silent, the nearest one first."""
    if who == names.VUT_ID:
        return names.SIL_WORLD, names.VUT_ADAPTER, names.SCENARIO_MANAGER
    if who in (names.SIL_WORLD, names.MONITOR, names.FRONT_CAMERA, names.SCENARIO_MANAGER):
        return who, names.SCENARIO_MANAGER
    return names.OBJECT_TARGET, names.SCENARIO_MANAGER


def with_busy_machine(outcome: RunOutcome, reason: str) -> RunOutcome:
    """Put a busy machine, a harness failure, first among the reasons; empty: change nothing."""
    if not reason or outcome.ok:
        return outcome
    return RunOutcome(Verdict.INVALID_HARNESS, (reason, *outcome.reasons))
