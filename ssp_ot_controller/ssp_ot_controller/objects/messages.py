"""The messages that the objects of a process hear, and their answers to heartbeats.

MessageBuffer hands messages on in the order in which they belong together. ManagerArbiter decides
which heartbeats are our manager's: two managers that both lead would pull an object to and fro,
so an object follows the one that it heard first, stops when it hears another beside it, and
follows a new one only when the old one has fallen silent and the object stands. NearbyObjects has
the newest states of others that are near enough to matter; whether it hears anything is the
manager's to judge. HeartbeatResponder answers on the system clock, outside the steps, so that the
manager can measure clocks and links: an object whose link is disturbed answers as late as its
messages would be.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ssp_core.cdr.steps import Heartbeat, WorldTick
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.run_file.session_token import mode_problem, token_problem
from ssp_core.vocabulary import SessionPhase
from ssp_ot_controller.sil.disturbance import LinkSizes


def in_step(tick: WorldTick) -> bool:
    """Tell whether the world waits for the answer to a tick."""
    return tick.lockstep and tick.running


class MessageBuffer:
    """Holds a lockstep tick back until the manager's messages that precede it are here.

    A tick names the manager's last heartbeat before it, and that heartbeat says how many
    references had been sent to each object; it also counts the states of the VUT. Outside lockstep
    nothing is held back.
    """

    def __init__(self, object_ids: Iterable[str]) -> None:
        self._ids = tuple(object_ids)
        self._beats: list[Heartbeat] = []
        self._last_beat: Heartbeat | None = None
        self._references: dict[str, list[Reference]] = {i: [] for i in self._ids}
        self._received = dict.fromkeys(self._ids, 0)
        self._states: list[ObjectState] = []
        self._vut_states = 0
        self._tick: WorldTick | None = None
        self._taken_step: int | None = None

    def on_heartbeat(self, beat: Heartbeat) -> None:
        self._last_beat = beat
        self._beats.append(beat)

    def on_reference(self, reference: Reference) -> None:
        if reference.object_id in self._references:
            self._references[reference.object_id].append(reference)
            self._received[reference.object_id] += 1

    def on_state(self, state: ObjectState) -> None:
        """Keep a state of the VUT or of another process's object."""
        self._states.append(state)
        # While the world holds, the VUT's first state is repeated and not counted.
        self._vut_states += state.object_id == VUT_ID and state.sequence > 1

    def on_tick(self, tick: WorldTick) -> None:
        """Keep the newest tick; a held one that the world didn't wait for is replaced.

        A step that was dealt with is said again while the world waits for a driver's answer.
        """
        if in_step(tick) and tick.step == self._taken_step:
            return
        self._tick = tick

    def take(self, *, overdue: bool = False) -> WorldTick | None:
        """Return the held tick if it may be dealt with now, else None.

        Args:
            overdue: what is still missing won't come; a manager that died has sent its last.
        """
        tick = self._tick
        if tick is None:
            return None
        if in_step(tick) and not (overdue or self._complete(tick)):
            return None
        self._tick = None
        self._taken_step = tick.step if in_step(tick) else None
        return tick

    def heartbeats(self, up_to: int | None, holding: bool) -> list[Heartbeat]:
        """Take out the heartbeats up to a sequence number, all with None.

        Args:
            up_to: last sequence number to be taken.
            holding: the world holds at step 0. A heartbeat that starts the run is then left for
                the first step, so that the start falls on the same step every time.
        """
        beats: list[Heartbeat] = []
        while self._beats:
            beat = self._beats[0]
            if up_to is not None and beat.sequence > up_to:
                break
            if holding and beat.session_state is SessionPhase.RUNNING:
                break
            beats.append(self._beats.pop(0))
        return beats

    def references(self, object_id: str) -> list[Reference]:
        """Take out the references to an object, in the order of arrival."""
        arrivals, self._references[object_id] = self._references[object_id], []
        return arrivals

    def states(self) -> list[ObjectState]:
        """Take out the states of others, in the order of arrival."""
        arrivals, self._states = self._states, []
        return arrivals

    def _complete(self, tick: WorldTick) -> bool:
        if self._vut_states < tick.vut_states_sent:
            return False
        heartbeat = tick.heartbeat
        if heartbeat == 0:
            return True
        beat = self._last_beat
        if beat is None or beat.sequence < heartbeat:
            return False
        tick_beat = next((b for b in self._beats if b.sequence == heartbeat), beat)
        return all(self._received[i] >= tick_beat.references_sent.get(i, 0) for i in self._ids)


# A stranger counts for so long after its last heartbeat.
_REMEMBERED_S = 1.0


class ManagerArbiter:
    """Tells our manager's heartbeats and commands from others'. Reads no clock.

    Args:
        silence_s: our manager has gone when it wasn't heard for longer.
        token: of the session; empty: the run file names none, and that of the first manager counts.
        mode: of the run file; a manager of another kind of session is never ours.
    """

    def __init__(self, silence_s: float, token: str = "", mode: str = "lockstep") -> None:
        self._silence_ns = seconds_to_ns(silence_s)
        self._token, self._mode = token, mode
        self._followed_token = token
        self._sender: str | None = None
        self._sequence = 0
        self._heartbeat_ns = 0
        self._strangers: dict[str, int] = {}

    def is_ours(
        self, sender: str, sequence: int, steady_ns: int, *, may_move: bool, token: str = ""
    ) -> bool:
        """Tell whether a heartbeat is to be obeyed.

        Args:
            sender: node that sent it.
            sequence: number of the heartbeat; one that doesn't rise is not obeyed.
            token: of the session that it leads.
            steady_ns: when it came, on the steady clock.
            may_move: an object moves or is about to, so that no other manager may take over.
        """
        is_of_session = token == self._token if self._token else not mode_problem(token, self._mode)
        gone = not may_move and self._is_silent(steady_ns)
        if is_of_session and (self._sender is None or gone):
            self._sender, self._sequence, self._followed_token = sender, 0, token
            self._strangers.pop(sender, None)
        if sender != self._sender or sequence <= self._sequence:
            self._strangers[sender] = steady_ns
            return False
        self._sequence, self._heartbeat_ns = sequence, steady_ns
        return True

    def command_problem(self, token: str, steady_ns: int) -> str:
        """Say why a command isn't of our manager's session; empty where it is.

        Args:
            token: that came with it.
            steady_ns: when the command came, on the steady clock.
        """
        follows = self._token or (self._sender is not None and not self._is_silent(steady_ns))
        return token_problem(self._followed_token if follows else "", token, self._mode)

    def _is_silent(self, steady_ns: int) -> bool:
        return steady_ns - self._heartbeat_ns > self._silence_ns

    def strangers(self, steady_ns: int) -> int:
        """Count the other managers that were heard of late."""
        if not self._strangers:
            return 0
        oldest_ns = steady_ns - seconds_to_ns(_REMEMBERED_S)
        return sum(heard_ns >= oldest_ns for heard_ns in self._strangers.values())


class NearbyObjects:
    """The newest states of the VUT and the object targets. Reads no clock.

    Args:
        limits: of the site; a state older than its state age says nothing any more.
    """

    def __init__(self, limits: Limits) -> None:
        self._separation_m = limits.separation_m
        self._oldest_ns = seconds_to_ns(limits.state_age_s)
        self._age_s = limits.state_age_s
        # With x, y, and how far from there anything of it may be while it is heard.
        self._neighbours: dict[str, tuple[float, float, float, ObjectState]] = {}

    def take(self, states: Iterable[ObjectState]) -> None:
        """Take states as they were heard; a broken one replaces none."""
        for state in states:
            if state.is_finite:
                far_m = state.size.reach_m + abs(state.speed_mps) * self._age_s
                self._neighbours[state.object_id] = (state.x_m, state.y_m, far_m, state)

    def near(self, own: ObjectState) -> list[ObjectState]:
        """List the objects that may be too close, by id, led on to the stamp of the own state."""
        neighbours = []
        x, y, mine_m = own.x_m, own.y_m, own.size.reach_m + self._separation_m
        for its_x, its_y, far_m, state in self._neighbours.values():
            near_m = mine_m + far_m
            if not (-near_m <= x - its_x <= near_m and -near_m <= y - its_y <= near_m):
                continue
            if state.object_id == own.object_id:
                continue
            age_ns = own.stamp_ns - state.stamp_ns
            if not -self._oldest_ns <= age_ns <= self._oldest_ns:
                continue
            # As far as it can have come in this time.
            near_m += abs(state.speed_mps) * (abs(ns_to_seconds(age_ns)) - self._age_s)
            if (x - its_x) ** 2 + (y - its_y) ** 2 <= near_m * near_m:
                neighbours.append(state.extrapolated(own.stamp_ns))
        return sorted(neighbours, key=lambda state: state.object_id)


# In lockstep a manager may beat a thousand times a second; more answers would measure nothing more.
_PERIOD_S = 0.01


@dataclass(frozen=True, slots=True)
class HeartbeatAnswer:
    """One answer; fields as in HeartbeatReply.msg.

    Args:
        object_ids: that it is given for, sorted.
        sent_ns: when the heartbeat was sent, on the manager's clock.
        received_ns: when it came, on the objects' clock.
        replied_ns: when the answer leaves, on the objects' clock; None: now.
        offset_ns: of the objects' clock, for an answer that leaves now.
    """

    sequence: int
    object_ids: tuple[str, ...]
    sent_ns: int
    received_ns: int
    replied_ns: int | None
    offset_ns: int = 0


class HeartbeatResponder:
    """Answers of one process, and those that are still under way. Reads no clock."""

    def __init__(self) -> None:
        self._answer_ns: int | None = None
        self._under_way: deque[tuple[int, HeartbeatAnswer]] = deque()

    def on_heartbeat(
        self, beat: Heartbeat, links: Mapping[str, LinkSizes], system_ns: int, steady_ns: int
    ) -> list[HeartbeatAnswer]:
        """Return the answers that leave at once; others are handed out by ``due``.

        Args:
            beat: of the manager.
            links: clock and delays of each object.
            system_ns: when it came, on this machine's clock.
            steady_ns: the same on the steady clock.
        """
        if self._answer_ns is not None and steady_ns - self._answer_ns < seconds_to_ns(_PERIOD_S):
            return []
        self._answer_ns = steady_ns
        groups: dict[LinkSizes, list[str]] = {}
        for object_id, link in sorted(links.items()):
            groups.setdefault(link, []).append(object_id)
        at_once = []
        for link, ids in groups.items():
            if link.cut:
                continue
            offset_ns = seconds_to_ns(link.clock_offset_s)
            received_ns = system_ns + seconds_to_ns(link.down_s) + offset_ns
            late_ns = seconds_to_ns(link.down_s) + seconds_to_ns(link.up_s)
            reply = HeartbeatAnswer(
                beat.sequence,
                tuple(ids),
                beat.sent_ns,
                received_ns,
                received_ns if late_ns else None,
                offset_ns,
            )
            if late_ns:
                self._under_way.append((steady_ns + late_ns, reply))
            else:
                at_once.append(reply)
        return at_once

    def due(self, steady_ns: int) -> list[HeartbeatAnswer]:
        """Return the answers that arrive by now, in the order in which they were given."""
        arrived = [reply for due_ns, reply in self._under_way if due_ns <= steady_ns]
        if arrived:
            self._under_way = deque(entry for entry in self._under_way if entry[0] > steady_ns)
        return arrived


def answers_late(run: RunSpec, object_ids: Iterable[str]) -> bool:
    """Tell whether the run delays messages of one of these objects at any time."""
    links = [run.disturbance_of(object_id) for object_id in object_ids]
    delayed = any(link.state_delay_s or link.command_delay_s for link in links)
    return delayed or any(fault.kind == "link_delay" for fault in run.faults)
