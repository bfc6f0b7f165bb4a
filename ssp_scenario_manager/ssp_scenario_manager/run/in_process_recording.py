"""The bag of a session in one process."""

from __future__ import annotations

from pathlib import Path

from ssp_core import names
from ssp_core.carla.acceptance import ServerOfRun
from ssp_core.cdr.references import encode_reference
from ssp_core.closing import Closing
from ssp_core.motion.event import PhaseBegan
from ssp_core.motion.reference import Reference
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.event_messages import encode_phase
from ssp_core.world.plant import StepReport
from ssp_core.world.recorder import make_recorder
from ssp_scenario_manager.session import outbox
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.session.messages import encode_session_state, encode_trigger


class SessionRecording(Closing):
    """Hands what a session's nodes would say to a recorder; see ssp_core.world.recorder.

    Args:
        run_file: holds ``spec``; its task lies beside it.
        bag: a new folder.
        server: that draws the camera's frames; None: our own renderer does.

    Raises:
        InputError, HostError: as make_recorder.
    """

    def __init__(
        self, spec: RunSpec, run_file: Path, bag: Path, server: ServerOfRun | None = None
    ) -> None:
        self._spec = spec
        self.recorder = make_recorder(spec, run_file, bag, server)

    def hear(self, report: StepReport) -> None:
        """Take a report of world, VUT and objects."""
        self.recorder.hear(report)

    def sent(self, fact: outbox.Outgoing) -> None:
        """Take a fact that the session sends."""
        recorder, spec = self.recorder, self._spec
        if isinstance(fact, Reference):
            recorder.sent(fact.object_id, encode_reference(fact), fact.dispatched_ns)
        elif isinstance(fact, outbox.StateChanged):
            recorder.take(names.SESSION_STATE, encode_session_state(fact, spec), fact.stamp_ns)
        elif isinstance(fact, outbox.TriggerDecision):
            # No time passes between a state and what follows from it.
            recorder.take(names.TRIGGER_EVENT, encode_trigger(fact, 0.0), fact.stamp_ns)
        elif isinstance(fact, PhaseBegan):
            recorder.take(names.PHASE_EVENT, encode_phase(fact), fact.stamp_ns)
        elif isinstance(fact, Violation):
            recorder.limit(fact.announcement(names.SCENARIO_MANAGER))

    def answer(self, now_ns: int, session: SessionPhase) -> None:
        """Take the manager's word after a step."""
        self.recorder.answer(now_ns, session)

    def close(self) -> None:
        self.recorder.close()
