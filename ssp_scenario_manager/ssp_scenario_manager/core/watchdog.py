"""What is looked at on the steady clock, whether time goes on in the session or not."""

from __future__ import annotations

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_scenario_manager.core.link_clock import WINDOW_S
from ssp_scenario_manager.core.patience import Patience
from ssp_scenario_manager.core.session import WATCHED, Session
from ssp_scenario_manager.core.supervisor import LATE_S
from ssp_scenario_manager.core.vigil import Vigil

# What was measured over the links while the manager was late is believed for link_clock.WINDOW_S.
_REMEMBERED_S = WINDOW_S + 0.5


class Watchdog:
    """Silence, links and patience of a session. Reads no clock: times are given, in ns.

    Args:
        session: that is watched.
        vigil: who was heard when.
    """

    def __init__(self, session: Session, vigil: Vigil) -> None:
        self._session = session
        self._vigil = vigil
        self._patience = Patience()
        self._awake_ns: int | None = None
        self._late = 0, 0.0

    def objects_were_told_to_arm(self, steady_ns: int) -> None:
        self._patience.arms(steady_ns)

    def wake(self, steady_ns: int) -> None:
        """The manager runs now, whatever for: how late is it, if nothing ran for long?

        Args:
            steady_ns: now, on the vigil's clock.
        """
        if self._awake_ns is not None and steady_ns - self._awake_ns > seconds_to_ns(LATE_S):
            self._late = steady_ns, ns_to_seconds(steady_ns - self._awake_ns)
        self._awake_ns = steady_ns
        at_ns, late_s = self._late
        recent = steady_ns - at_ns <= seconds_to_ns(_REMEMBERED_S)
        self._session.late_s = late_s if recent else 0.0

    def look(self, steady_ns: int, now_ns: int) -> bool:
        """Tells the session what is known now, and ends what has waited for too long.

        A session stays armed only if every object says in time that it is.

        Args:
            steady_ns: now, on the vigil's clock.
            now_ns: session time.

        Returns:
            True when the session aborts and nobody is left to report a standstill.
        """
        self.wake(steady_ns)
        session = self._session
        session.facts = self._vigil.facts(session.spec, steady_ns)
        self.watch_silence(steady_ns, now_ns)
        if session.spec is not None:
            reason = self._patience.not_armed(
                session.spec, session.state, session.targets, steady_ns
            )
            if reason is not None:
                session.arming_failed(now_ns, reason)
        return self._patience.standstill_unconfirmed(session, self._vigil, steady_ns, now_ns)

    def watch_silence(self, steady_ns: int, now_ns: int) -> None:
        """Ends a session in which somebody is silent for too long; arguments as for look."""
        spec, state = self._session.spec, self._session.state
        if spec is not None and state in WATCHED:
            for violation in self._vigil.violations(spec, state, steady_ns, now_ns):
                self._session.fail(violation)
