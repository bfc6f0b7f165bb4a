"""The recorder of a session in one process: its bag holds what the nodes' messages would be.

What the wall clock decides in a session of several processes isn't there: answers to heartbeats,
measured links, the recorder's own status. All else is a function of the run, so that the same run
gives the same bytes.
"""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ssp_core import names
from ssp_core.bag.drive_messages import drive_messages
from ssp_core.bag.writing.chain import Maker
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.carla.acceptance import ServerOfRun
from ssp_core.carla.record import encode_server
from ssp_core.cdr.references import encode_ack
from ssp_core.cdr.states import StateArray, encode_state, encode_states
from ssp_core.cdr.steps import Heartbeat, WorldTick, encode_clock, encode_heartbeat, encode_tick
from ssp_core.closing import Closing
from ssp_core.errors import SspError
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.camera import intrinsics
from ssp_core.world.camera_messages import encode_camera_info, encode_frame
from ssp_core.world.event_messages import encode_fault, encode_limit
from ssp_core.world.plant import LimitFact, StepReport, make_camera
from ssp_core.world.transforms import (
    TransformFilter,
    encode_transform,
    encode_transforms,
    mount,
    of_camera,
)
from ssp_monitor.recorder.plan import run_attachments
from ssp_monitor.recorder.recorder import LATCHED, OFFERED, TopicRecord
from ssp_monitor.recorder.report import TopicCounts, report_attachment, seals
from ssp_monitor.recorder.topics import bag_topics

# A recorder in one process receives what there is.
_NOTHING: Counter[str] = Counter()


class InProcessRecorder(Closing):
    """Record a session that runs in one process, as the monitor records one of nodes.

    It is a ssp_core.world.recorder.SessionRecorder.

    Args:
        run: whose camera, if it has one, is drawn here.
        run_file: of the run, with its task beside it.
        bag: a new folder.
        server: that draws the frames; None: our own renderer does.

    Attributes:
        not_given_back: what the server couldn't be given back at the close, in words.

    Raises:
        InputError: the folder exists, or a file of the task can't be taken, or the run asks a
            server and none is given.
        HostError: the disk doesn't take it, or CARLA's client isn't installed.
    """

    def __init__(
        self, run: RunSpec, run_file: Path, bag: Path, server: ServerOfRun | None = None
    ) -> None:
        self._run = run
        self.not_given_back: list[str] = []
        self._attachments = run_attachments(run_file)
        self._camera = None if run.camera is None else make_camera(run, server, self._take_server)
        # A campaign keeps thousands of driven runs.
        packed = run.driven is not None
        self._writer = BagWriter(bag, maker=Maker.RECORDER, packed=packed)
        self._records: dict[str, TopicRecord] = {}
        for name, media_type, data in self._attachments:
            self._writer.attach(name, data, media_type)
        for topic in bag_topics(run):
            latched = topic.profile in LATCHED
            self._writer.add_topic(
                topic.name, topic.msgtype, OFFERED[topic.profile], latched=latched
            )
            self._records[topic.name] = TopicRecord(topic.name, topic.msgtype)
        self._poses = TransformFilter()
        self._newest: dict[str, ObjectState] = {}
        self._heartbeats = 0
        self._vut_states = 0
        self._picture_step = -1
        self._now_ns = 0
        self._references = {target.id: 0 for target in run.targets}
        if run.camera is not None:
            self.take(names.CAMERA_MOUNT, encode_transform(mount(run.camera)), 0)
            self.take(names.TF_STATIC, encode_transforms(of_camera(run.camera)), 0)

    def take(self, topic: str, message: bytes, stamp_ns: int) -> None:
        """Write one message.

        Args:
            topic: by its name in ssp_core.names.
            message: serialised.
            stamp_ns: its time, session time.
        """
        record = self._records[names.absolute(topic)]
        self._writer.write(record.name, message, stamp_ns, stamp_ns, record.messages + 1)
        record.note(stamp_ns, len(message))

    def hear(self, report: StepReport) -> None:
        """Write what world, VUT and objects say in a step, and the frame of the step."""
        now_ns = self._now_ns = report.now_ns
        for state in report.vut_states:
            self.take(names.state_topic(state.object_id), encode_state(state), state.stamp_ns)
        self._vut_states += len(report.vut_states) if report.running else 0
        tick = WorldTick(
            now_ns,
            report.step,
            report.running,
            True,
            self._heartbeats,
            self._vut_states,
            report.truths,
        )
        self.take(names.WORLD_TICK, encode_tick(tick), now_ns)
        self.take(names.CLOCK, encode_clock(now_ns), now_ns)
        for fault in report.faults:
            self.take(names.FAULT_EVENT, encode_fault(fault), fault.stamp_ns)
        for ack in report.acks:
            self.take(names.ack_topic(ack.object_id), encode_ack(ack), ack.stamp_ns)
        for passed in report.limits:
            self.limit(passed, "local_stop" if passed.source == names.OBJECT_TARGET else "abort")
        self._target_states(report.target_states)
        self._newest |= {s.object_id: s for s in (*report.vut_states, *report.target_states)}
        self._draw(report)
        if report.drive is not None and self._run.driven is not None:
            drive = drive_messages(self._run.driven, self._run.vut.id, report.drive, now_ns)
            for topic, message in drive:
                self.take(topic, message, now_ns)

    def limit(self, passed: LimitFact, reaction: str = "abort") -> None:
        """Write a limit that was passed, and what follows from it."""
        self.take(names.SAFETY_EVENT, encode_limit(passed, reaction), passed.stamp_ns)

    def answer(self, now_ns: int, session: SessionPhase) -> None:
        """Write what the manager says at the end of each step, after its facts."""
        vut, *_ = ids = self._run.object_ids
        states = [self._newest[i] for i in (vut, *sorted(ids[1:])) if i in self._newest]
        if news := self._poses.news(states):
            stamp_ns = news[0].stamp_ns
            self.take(names.TF, encode_transforms(news), stamp_ns)
        self._heartbeats += 1
        beat = Heartbeat(
            now_ns,
            names.SCENARIO_MANAGER,
            self._heartbeats,
            now_ns,
            session,
            dict(self._references),
        )
        self.take(names.HEARTBEAT, encode_heartbeat(beat), now_ns)

    def sent(self, object_id: str, reference: bytes, stamp_ns: int) -> None:
        """Write a reference that an object is sent."""
        self._references[object_id] += 1
        self.take(names.reference_topic(object_id), reference, stamp_ns)

    def close(self) -> None:
        """Give the camera back, attach the recorder's report and close the bag."""
        if self._writer.closed:
            return
        if self._camera is not None:
            self.not_given_back = self._camera.close()
        received = {r.name: r.messages for r in self._records.values()}
        counted = TopicCounts(received, _NOTHING, _NOTHING)
        name, media_type, data = report_attachment(
            self._records.values(),
            counted,
            run_id=self._run.run_id,
            missing=0,
            lost_limit=0,
            warnings=(),
            sealed=seals(self._attachments),
        )
        self._writer.attach(name, data, media_type)
        self._writer.close()

    def _take_server(self, record: Mapping[str, Any]) -> None:
        self.take(names.CAMERA_RENDERER, encode_server(record), self._now_ns)

    def _target_states(self, states: tuple[ObjectState, ...]) -> None:
        if not self._run.states_in_one:
            for state in states:
                self.take(names.state_topic(state.object_id), encode_state(state), state.stamp_ns)
        elif states:
            newest_ns = max(state.stamp_ns for state in states)
            array = StateArray(newest_ns, names.OBJECT_TARGET, states)
            self.take(names.OBJECT_STATES, encode_states(array), newest_ns)

    def _draw(self, report: StepReport) -> None:
        if self._camera is None or self._run.camera is None or report.step == self._picture_step:
            return
        self._picture_step = report.step
        question = None if report.drive is None else report.drive.question
        # What the driver of a driven run was shown is what is recorded.
        jpeg = question.frames[-1].jpeg if question is not None and question.frames else None
        picture = self._camera.picture(report.step, report.now_ns, report.truths, jpeg)
        if picture is not None:
            info = encode_camera_info(report.now_ns, intrinsics(self._run.camera))
            self.take(names.CAMERA_INFO, info, report.now_ns)
            self.take(names.CAMERA_IMAGE, encode_frame(report.now_ns, picture), report.now_ns)


def make_recorder(
    run: RunSpec, run_file: Path, bag: Path, server: ServerOfRun | None = None
) -> InProcessRecorder:
    """Return the recorder of a run, see ssp_core.world.recorder.make_recorder."""
    is_new = not os.path.lexists(bag)
    try:
        return InProcessRecorder(run, run_file, bag, server)
    except SspError:
        if is_new:  # no session has begun, of which it could hold anything
            shutil.rmtree(bag, ignore_errors=True)
        raise
