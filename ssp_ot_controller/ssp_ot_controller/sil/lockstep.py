"""Who has still to answer a step before the world may go on (lockstep)."""

from __future__ import annotations

from collections.abc import Iterable

from ssp_core.cdr.steps import RECORDER_LAG_STEPS


class StepBarrier:
    """Answers of the participants by step; those that were dropped aren't waited for.

    Args:
        participants: nodes that answer every step.
        object_ids: objects whose actuator command is part of the answer of ``owner``.
        owner: the participant that commands the objects.
        camera: the participant that answers frame steps only, None for none.
        leader: the participant that answers after all others.
        frame_steps: every how many steps a frame is due; the camera may lag that much.
        recorder: the participant that may lag RECORDER_LAG_STEPS, and is waited for once it was
            heard; None for none.
    """

    def __init__(
        self,
        participants: Iterable[str],
        object_ids: Iterable[str],
        owner: str,
        camera: str | None,
        frame_steps: int,
        leader: str,
        recorder: str | None = None,
    ) -> None:
        # Step 0, at which the world holds, is answered again and again: whose answer has come once
        # is heard, which a participant that has just been discovered isn't for sure.
        self._done = dict.fromkeys(participants, -1)
        self._commanded = dict.fromkeys(object_ids, -1)
        self._owner = owner
        self._camera = camera
        self._leader = leader
        self._frame_steps = frame_steps
        self._frame_done = -1
        self._recorder = recorder
        self._recorded: int | None = None
        self.dropped: set[str] = set()

    def on_done(self, participant: str, step: int) -> None:
        if participant == self._camera:
            self._frame_done = max(self._frame_done, step)
        elif participant == self._recorder:
            self._recorded = max(self._recorded or 0, step)
        elif participant in self._done:
            self._done[participant] = max(self._done[participant], step)

    def on_command(self, object_id: str, step: int) -> None:
        if object_id in self._commanded:
            self._commanded[object_id] = max(self._commanded[object_id], step)

    def drop(self, participant: str) -> None:
        """From now on the world goes on without this participant."""
        self.dropped.add(participant)

    def unheard(self) -> list[str]:
        """Whose answer to step 0 is missing; the leader's, which starts the run, comes later."""
        missing = [name for name in self.waiting_for(0) if name != self._leader]
        if self._recorder is not None and self._recorded is None:
            missing.append(self._recorder)
        return missing

    def lost(self, step: int) -> list[str]:
        """Of those that are waited for, the ones that don't wait for another one themselves.

        The leader answers a step when the others have: while one of them is missing, its own
        silence says nothing.
        """
        missing = self.waiting_for(step)
        return [name for name in missing if name != self._leader] or missing

    def waiting_for(self, step: int) -> list[str]:
        """Participants that keep the world from going on from ``step`` to ``step + 1``."""
        missing = [name for name, done in self._done.items() if done < step]
        if self._owner not in missing and any(c < step for c in self._commanded.values()):
            missing.append(self._owner)
        if self._camera is not None:
            newest_due = (step + 1 - self._frame_steps) // self._frame_steps * self._frame_steps
            if newest_due >= 0 and self._frame_done < newest_due:
                missing.append(self._camera)
        if self._recorded is not None and step - self._recorded > RECORDER_LAG_STEPS:
            missing.append(str(self._recorder))
        return [name for name in missing if name not in self.dropped]
