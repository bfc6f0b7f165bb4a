"""The lines that a replay prints: its plan, its progress, and how it ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ssp_core.clock import ns_to_seconds
from ssp_monitor.replay.plan import OmittedTopic, Plan
from ssp_monitor.replay.player import Lateness, Progress

# Nobody notices less on a screen, and a loaded machine is late by as much now and then.
BEHIND_NS = 100_000_000
_MOST_NAMED = 8


def plan_lines(plan: Plan) -> list[str]:
    """List the topics that are published and those that aren't, for people."""
    lines = []
    commands = [one for one in plan.left_out if one.is_command]
    if commands:
        topics_text = ", ".join(f"{one.topic} ({one.count})" for one in commands[:_MOST_NAMED])
        more = f" and {len(commands) - _MOST_NAMED} more" if len(commands) > _MOST_NAMED else ""
        lines.append(
            f"left out, since objects may act on it: {topics_text}{more} (--commands: not)"
        )
    lines += [
        f"left out: {one.topic} ({one.count} messages): {one.why}"
        for one in plan.left_out
        if not one.is_command
    ]
    lines += [
        f"{line.recorded} as {line.topic}" for line in plan.lines if line.topic != line.recorded
    ]
    if plan.clock_recorded:
        lines.append("/clock as recorded (--clock HZ: made from the bag's times instead)")
    elif plan.clock_hz:
        lines.append(f"/clock at {plan.clock_hz:g} Hz from the bag's times of reception")
    return lines


def progress_line(progress: Progress, start_ns: int, end_ns: int, topics: int) -> str:
    """Return bag time, rate and topics in one line."""
    at_s, length_s = (ns_to_seconds(ns - start_ns) for ns in (progress.bag_ns, end_ns))
    words = [
        f"{at_s:9.3f} of {length_s:.3f} s",
        "paused" if progress.paused else f"x{progress.rate:g}",
        f"{topics} topics",
        f"{progress.sent} messages",
    ]
    if progress.lap > 1:
        words.append(f"lap {progress.lap}")
    if progress.behind_ns > BEHIND_NS:
        words.append(f"{ns_to_seconds(progress.behind_ns):.1f} s behind schedule")
    return " · ".join(words)


@dataclass(frozen=True, slots=True)
class ReplayOutcome:
    """The ending of a replay.

    Args:
        why: ``end`` of the bag, or what stopped it.
        unacknowledged: topics on which a subscriber didn't confirm everything in time.
    """

    why: str
    progress: Progress
    lateness: Lateness
    plan: Plan
    unacknowledged: Sequence[str] = ()

    def as_json(self) -> dict[str, Any]:
        late = self.lateness
        return {
            "ended": self.why,
            "messages": self.progress.sent,
            "laps": self.progress.lap,
            "rate": self.progress.rate,
            "topics": {line.topic: line.count for line in self.plan.lines},
            "left_out": [_left_out_json(one) for one in self.plan.left_out],
            "clock": "recorded" if self.plan.clock_recorded else self.plan.clock_hz,
            "late_s": {
                "p50": ns_to_seconds(late.quantile_ns(0.5)),
                "p99": ns_to_seconds(late.quantile_ns(0.99)),
                "max": ns_to_seconds(late.most_ns),
            },
            "unacknowledged": list(self.unacknowledged),
        }

    def lines(self) -> list[str]:
        late = self.lateness
        summary_lines = [
            f"{self.progress.sent} messages of {len(self.plan.lines)} topics sent; late by "
            f"{late.quantile_ns(0.5) / 1e6:.2f} ms (median), {late.quantile_ns(0.99) / 1e6:.2f} ms "
            f"(99 %), {late.most_ns / 1e6:.2f} ms (at most)"
        ]
        if late.quantile_ns(0.99) > BEHIND_NS:
            summary_lines.append(
                "this machine did not keep up with the rate: a lower --rate or fewer --topics help"
            )
        summary_lines += [
            f"{topic}: a subscriber did not confirm all" for topic in self.unacknowledged
        ]
        return summary_lines


def _left_out_json(one: OmittedTopic) -> dict[str, Any]:
    return {"topic": one.topic, "messages": one.count, "why": one.why}
