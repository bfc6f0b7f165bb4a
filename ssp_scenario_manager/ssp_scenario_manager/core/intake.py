"""States as they arrive: into the session, and into the books on who was heard and what is lost."""

from __future__ import annotations

from collections.abc import Callable

from ssp_core import names
from ssp_core.cdr.states import StateArray
from ssp_core.motion.state import ObjectState
from ssp_scenario_manager.core.arrivals import Arrivals
from ssp_scenario_manager.core.barrier import StepInputs
from ssp_scenario_manager.core.session import Session
from ssp_scenario_manager.core.tally import Tallies
from ssp_scenario_manager.core.vigil import Vigil


class Intake:
    """Takes states in. Reads no clock: arrivals on the steady clock are given, in ns.

    Args:
        session: that gets them.
        vigil: notes who was heard.
        inputs: counts the states of a run, for lockstep.
        decode: reads a message with the states of many; None for bytes that are none.
        tell: takes a line for people.
    """

    def __init__(
        self,
        session: Session,
        vigil: Vigil,
        inputs: StepInputs,
        decode: Callable[[bytes], StateArray | None],
        tell: Callable[[str], None],
    ) -> None:
        self.tallies = Tallies()
        self.arrivals = Arrivals()
        self._session = session
        self._vigil = vigil
        self._inputs = inputs
        self._decode = decode
        self._tell = tell
        self._strangers: set[str] = set()

    def vut(self, state: ObjectState, steady_ns: int) -> bool:
        """Takes a state of the VUT; False for one that isn't the VUT's."""
        if not self._session.on_vut_state(state):
            self.tell_stranger(state.object_id, "sends states as the vehicle under test")
            return False
        self._vigil.hear(names.VUT_ID, steady_ns)
        self.tallies.see(state.object_id, state.sequence)
        # The first is repeated while the world holds, and belongs to no step.
        self._inputs.vut_states += state.sequence > 1
        return True

    def target(self, state: ObjectState, steady_ns: int) -> None:
        """Takes a state of an object target; a stranger's only counts for its process."""
        if self._session.on_target_state(state):
            self._vigil.hear(state.object_id, steady_ns)
            self.tallies.see(state.object_id, state.sequence)
        else:
            self.tell_stranger(state.object_id, "sends states, but the run doesn't know it")
        self._inputs.states += state.sequence > 1

    def waiting(self) -> None:
        """Takes the states of many that have waited in ``arrivals``."""
        for data, arrived_ns in self.arrivals.take():
            array = self._decode(data)
            for state in array.states if array is not None else ():
                self.target(state, arrived_ns)

    def tell_stranger(self, who: str, what: str) -> None:
        """Says once that somebody is heard who has no part in this session."""
        if who not in self._strangers:
            self._strangers.add(who)
            self._tell(f"{who} is not listened to: {what}")
