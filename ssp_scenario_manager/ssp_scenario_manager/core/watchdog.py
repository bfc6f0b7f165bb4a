"""What is looked at on the steady clock, whether time goes on in the session or not."""

from __future__ import annotations

from ssp_scenario_manager.core.patience import Patience
from ssp_scenario_manager.core.session import WATCHED, Session
from ssp_scenario_manager.core.vigil import Vigil


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

    def objects_were_told_to_arm(self, steady_ns: int) -> None:
        self._patience.arms(steady_ns)

    def look(self, steady_ns: int, now_ns: int) -> bool:
        """Tells the session what is known now, and ends what has waited for too long.

        A session stays armed only if every object says in time that it is.

        Args:
            steady_ns: now, on the vigil's clock.
            now_ns: session time.

        Returns:
            True when the session aborts and nobody is left to report a standstill.
        """
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
