"""Messages of an object target node, handed on in the order in which they belong together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.names import VUT_ID
from ssp_core.vocabulary import SessionPhase


@dataclass(frozen=True, slots=True)
class Beat:
    """One heartbeat of the manager."""

    sequence: int
    session: SessionPhase
    stamp_ns: int
    references_sent: Mapping[str, int]


class Inbox:
    """Holds a lockstep tick back until the manager's messages that precede it are here.

    A tick names the manager's last heartbeat before it, and that heartbeat says how many
    references had been sent to each object; it also counts the states of the VUT. Outside lockstep
    nothing is held back.

    Args:
        object_ids: the objects of this node.
    """

    def __init__(self, object_ids: Iterable[str]) -> None:
        self._ids = tuple(object_ids)
        self._beats: list[Beat] = []
        self._last_beat: Beat | None = None
        self._references: dict[str, list[Reference]] = {i: [] for i in self._ids}
        self._received = dict.fromkeys(self._ids, 0)
        self._states: list[ObjectState] = []
        self._vut_states = 0
        self._tick: Any = None

    def on_heartbeat(
        self, sequence: int, session: SessionPhase, stamp_ns: int, sent: Mapping[str, int]
    ) -> None:
        self._last_beat = Beat(sequence, session, stamp_ns, sent)
        self._beats.append(self._last_beat)

    def on_reference(self, reference: Reference) -> None:
        if reference.object_id in self._references:
            self._references[reference.object_id].append(reference)
            self._received[reference.object_id] += 1

    def on_state(self, state: ObjectState) -> None:
        """A state of the VUT or of another process's object."""
        self._states.append(state)
        # While the world holds, the VUT's first state is repeated and not counted.
        self._vut_states += state.object_id == VUT_ID and state.sequence > 1

    def on_tick(self, tick: Any) -> None:
        """Keeps the newest WorldTick; a held one that the world didn't wait for is replaced."""
        self._tick = tick

    def take(self, *, overdue: bool = False) -> Any:
        """The held tick if it may be dealt with now, else None.

        Args:
            overdue: what is still missing won't come; a manager that died has sent its last.
        """
        tick = self._tick
        if tick is None:
            return None
        if tick.lockstep and tick.running and not (overdue or self._complete(tick)):
            return None
        self._tick = None
        return tick

    def heartbeats(self, up_to: int | None, holding: bool) -> list[Beat]:
        """Takes out the heartbeats up to a sequence number, all with None.

        Args:
            up_to: last sequence number to be taken.
            holding: the world holds at step 0. A heartbeat that starts the run is then left for
                the first step, so that the start falls on the same step every time.
        """
        taken: list[Beat] = []
        while self._beats:
            beat = self._beats[0]
            if up_to is not None and beat.sequence > up_to:
                break
            if holding and beat.session is SessionPhase.RUNNING:
                break
            taken.append(self._beats.pop(0))
        return taken

    def references(self, object_id: str) -> list[Reference]:
        """Takes out the references to an object, in the order of arrival."""
        taken, self._references[object_id] = self._references[object_id], []
        return taken

    def states(self) -> list[ObjectState]:
        """Takes out the states of others, in the order of arrival."""
        taken, self._states = self._states, []
        return taken

    def _complete(self, tick: Any) -> bool:
        if self._vut_states < tick.vut_states_sent:
            return False
        heartbeat = tick.heartbeat
        if heartbeat == 0:
            return True
        beat = self._last_beat
        if beat is None or beat.sequence < heartbeat:
            return False
        named = next((b for b in self._beats if b.sequence == heartbeat), beat)
        return all(self._received[i] >= named.references_sent.get(i, 0) for i in self._ids)
