"""A bag as a clip: frames and ego history up to a time, and never anything later."""

from __future__ import annotations

import os
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple

from ssp_core.bag.pictures.frames import Frames
from ssp_core.bag.reading.reader import BagReader, content_sha256
from ssp_core.bag.seals.declaration import read_declaration
from ssp_core.bag.types import BagMessage
from ssp_core.cdr.images import IMAGE_TYPES
from ssp_core.cdr.messages import object_state, peek_stamp_ns
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.closing import Closing
from ssp_core.errors import InputError, not_read
from ssp_core.motion.state import ObjectState
from ssp_core.names import CAMERA_IMAGE, CAMERA_INFO, CAMERA_MOUNT, VUT_ID, absolute, state_topic
from ssp_core.world.camera import Intrinsics, Mounting
from ssp_eval.data.provenance import Provenance, bag_folder, read_provenance
from ssp_eval.recordings.event import Crop
from ssp_eval.recordings.sight import Optics
from ssp_eval.score.thresholds import DEFAULT
from ssp_vla_bridge.messages import TASK, CameraGeometry, DrivingTask, EgoSample, Frame, Request
from ssp_vla_bridge.window import Preprocessing, choose, ego_history, geometry_of, mounting_of

# Nine questions of ten frames of 960 × 540 px.
_MOST_BYTES = 32 << 20


@dataclass(frozen=True)
class Question:
    """A request for one label time; ``t_s`` is the clip time of its newest frame."""

    label_t_s: float
    t_s: float
    request: Request


@dataclass(frozen=True)
class NoQuestion:
    """The reason why there is no question at a label time."""

    label_t_s: float
    reason: str


class BagFiles:
    """The files of a bag as they were when it was opened."""

    def __init__(self, bag: BagReader) -> None:
        self._before = {file: _state(file) for file in bag.files}

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Refuse what is read within the block if the bag was changed: it has another hash.

        It is refused for that also where reading it failed, since what is read by the index of
        another file looks damaged.

        Raises:
            InputError: naming the file.
        """
        try:
            yield
        finally:
            self.check_same()

    def check_same(self) -> None:
        """Compare size and time of each file with those at the beginning.

        Raises:
            InputError: naming the file.
        """
        for file, before in self._before.items():
            if _state(file) != before:
                raise InputError(
                    "was changed while it was read",
                    file=file,
                    remedy="don't change a recording while it is read; give the command again",
                )


class BagContent(Closing):
    """The content of an open bag.

    Hashing gives the interpreter free: it costs no time where a processor is idle.

    Raises:
        InputError: a file of it is gone.
    """

    def __init__(self, bag: BagReader) -> None:
        self._files = BagFiles(bag)
        self._closed = Event()
        self._beside = ThreadPoolExecutor(1)
        self._digest = self._beside.submit(content_sha256, bag, self._go_on)
        self._beside.shutdown(wait=False)  # the thread ends with the hash

    def _go_on(self) -> None:
        if self._closed.is_set():
            raise CancelledError

    @property
    def is_hashed(self) -> bool:
        """True when no time is needed for the hash."""
        return self._digest.done()

    @property
    def sha256(self) -> str:
        """Hash of what was in the bag when it was opened; waits until it is known.

        Raises:
            InputError: a file of it can't be read, or was changed since.
        """
        with self.watched():
            return self._digest.result()

    def watched(self) -> AbstractContextManager[None]:
        """Refuse what is read within the block if the bag was changed: see BagFiles."""
        return self._files.watched()

    def close(self) -> None:
        """End the hashing at once: after Ctrl-C it must not go on over a hundred gigabytes."""
        self._closed.set()
        self._beside.shutdown()


def _state(file: Path) -> tuple[int, int]:
    # Not the number of the file: some network file systems give a new one each time.
    try:
        status = os.stat(file)
    except OSError as error:
        raise not_read(file, error) from error
    return status.st_size, status.st_mtime_ns


_IMAGE = absolute(CAMERA_IMAGE)
_INFO = absolute(CAMERA_INFO)
_MOUNT = absolute(CAMERA_MOUNT)
_VUT_STATE = absolute(state_topic(VUT_ID))
_DEFAULT_RULES = Preprocessing()


class _Entry(NamedTuple):
    stamp_ns: int
    log_time_ns: int


class _Entries:
    """The places of a topic's messages, by their stamps; sixteen bytes a message.

    Args:
        entries: in any order.
    """

    def __init__(self, entries: list[_Entry]) -> None:
        entries.sort()
        self.stamps_ns = array("q", (entry.stamp_ns for entry in entries))
        self._log_times_ns = array("q", (entry.log_time_ns for entry in entries))

    def __getitem__(self, index: int) -> _Entry:
        return _Entry(self.stamps_ns[index], self._log_times_ns[index])

    def within(self, first_ns: int, last_ns: int) -> _Entries:
        """Return the frames whose stamps lie between two instants, ends included."""
        low = bisect_left(self.stamps_ns, first_ns)
        high = bisect_right(self.stamps_ns, last_ns)
        return _Entries([self[index] for index in range(low, high)])


class QuestionCache:
    """The questions under the rules that were used last, as far as there is room for them."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all questions."""
        self._rules: Preprocessing | None = None
        self._questions: dict[float, Question | NoQuestion] = {}
        self._left_bytes = _MOST_BYTES

    def get(self, label_t_s: float, rules: Preprocessing) -> Question | NoQuestion | None:
        """Return the question about a label time, None if it isn't kept; other rules clear all."""
        if rules != self._rules:
            self.clear()
            self._rules = rules
        return self._questions.get(label_t_s)

    def put(self, label_t_s: float, question: Question | NoQuestion) -> None:
        """Keep a question under the rules of the last ``get``, if there is room."""
        frames = question.request.frames if isinstance(question, Question) else ()
        size = sum(len(frame.jpeg) for frame in frames)
        if size <= self._left_bytes:
            self._left_bytes -= size
            self._questions[label_t_s] = question


class Clip(Closing):
    """A recorded session or an imported video, open for evaluation; a context manager.

    Raises:
        InputError: it is no bag, wasn't made by this project, or has no camera frames.
    """

    def __init__(self, path: str | Path, task: DrivingTask = TASK) -> None:
        self.path = Path(path)
        self.task = task
        self._stack = ExitStack()
        try:
            self._bag = self._stack.enter_context(BagReader(self.path))
            self._content = self._stack.enter_context(BagContent(self._bag))
            with self._content.watched():
                self._provenance = read_provenance(self._bag, "")
                self._check_frames()
                self._frames, self._states = self._index()
                self.camera, self.mount = self._camera()
        except BaseException:
            self._stack.close()
            raise
        self._question_cache = QuestionCache()
        self.crop: Crop | None = None
        start_ns = self._provenance.session_start_ns
        self.start_ns = self._frames.stamps_ns[0] if start_ns is None else start_ns

    @cached_property
    def provenance(self) -> Provenance:
        """Return the bag's provenance; waits until its hash is known.

        Raises:
            InputError: a file of it can't be read, or was changed since the clip was opened.
        """
        if self._provenance.declaration_sha256 is not None:
            read_declaration(bag_folder(self.path), self._content.sha256)
        return replace(self._provenance, bag_sha256=self._content.sha256)

    @property
    def is_hashed(self) -> bool:
        """True when no time is needed for the bag's hash."""
        return self._content.is_hashed

    def _check_frames(self) -> None:
        info = self._bag.topics.get(_IMAGE)
        if info is None or info.count == 0:
            raise InputError(
                f"has no camera frames (no message on {_IMAGE})",
                file=self.path,
                remedy=f"its topics are {', '.join(sorted(self._bag.topics)) or 'none'}",
            )
        if info.msgtype not in IMAGE_TYPES:
            raise InputError(
                f"must be of one of the types {', '.join(IMAGE_TYPES)}",
                file=self.path,
                field=_IMAGE,
                value=info.msgtype,
                remedy="record or import the camera as one of these",
            )

    def _index(self) -> tuple[_Entries, _Entries]:
        frames: list[_Entry] = []
        states: list[_Entry] = []
        for message in self._bag.messages([_IMAGE, _VUT_STATE]):
            try:
                stamp = peek_stamp_ns(message.data)
            except ValueError as error:
                raise InputError(
                    f"holds a message at {message.log_time_ns} ns that is no message: {error}",
                    file=self.path,
                    field=message.topic,
                    remedy="record the bag again",
                ) from error
            entries = frames if message.topic == _IMAGE else states
            entries.append(_Entry(stamp, message.log_time_ns))
        return _Entries(frames), _Entries(states)

    def _camera(self) -> tuple[CameraGeometry | None, Mounting | None]:
        if self._provenance.camera == "unknown":
            return None, None
        info, transform = self._first(_INFO), self._first(_MOUNT)
        mount = None if transform is None else mounting_of(transform.transform)
        geometry = None if info is None else geometry_of(info, mount)
        return geometry, None if geometry is None else mount

    @property
    def optics(self) -> Optics | None:
        """The camera and where it sits; None where one of both isn't known."""
        c = self.camera
        if c is None or self.mount is None:
            return None
        lens = Intrinsics(c.width_px, c.height_px, c.fx_px, c.fy_px, c.cx_px, c.cy_px)
        return Optics(lens, self.mount)

    def _first(self, topic: str) -> Any:
        message = next(iter(self._bag.messages([topic])), None)
        return None if message is None else self._bag.decode(message)

    @property
    def first_s(self) -> float:
        """Clip time of the first frame."""
        return ns_to_seconds(self._frames.stamps_ns[0] - self.start_ns)

    @property
    def last_s(self) -> float:
        """Clip time of the last frame."""
        return ns_to_seconds(self._frames.stamps_ns[-1] - self.start_ns)

    def question(
        self, label_t_s: float, rules: Preprocessing = _DEFAULT_RULES
    ) -> Question | NoQuestion:
        """Make the question about a label time: nothing in it is later than that time.

        The request's own time is the newest frame's, so that frames, history, trajectory and
        record all mean the same instant (METHOD 5.4).

        Raises:
            InputError: a file of the bag can't be read, or was changed since the clip was opened.
        """
        question = self._question_cache.get(label_t_s, rules)
        if question is None:
            with self._content.watched():
                question = self._question(label_t_s, rules)
            self._question_cache.put(label_t_s, question)
        return question

    def last_arrived(
        self, frames: Sequence[Frame], is_lost: Callable[[int], bool]
    ) -> tuple[Frame, ...]:
        """Return frames of the clip as they are shown where some of the clip's are lost.

        In place of a lost one the last picture is shown that came before it, at the same stamp;
        where none came, its own.

        Args:
            frames: of the clip.
            is_lost: whether the frame at a stamp is.

        Raises:
            InputError: a file of the bag can't be read, or was changed since the clip was opened.
        """
        entries = {}
        for frame in frames:
            index = bisect_left(self._frames.stamps_ns, frame.stamp_ns)
            while index >= 0 and is_lost(self._frames.stamps_ns[index]):
                index -= 1
            entries[frame.stamp_ns] = self._frames[index] if index >= 0 else None
        with self._content.watched():
            arrivals = [entry for entry in entries.values() if entry is not None]
            jpegs = {f.stamp_ns: f.jpeg for f in self._fetch(arrivals)} if arrivals else {}
        return tuple(
            frame
            if (entry := entries[frame.stamp_ns]) is None
            else replace(frame, jpeg=jpegs[entry.stamp_ns])
            for frame in frames
        )

    def crop_to(self, crop: Crop | None) -> None:
        """Treat the recording from here on as if it had been cut to a clip (METHOD 4.1).

        No frame and no state outside it is in any question, so that a recording with a long
        run-up gives a model no more than its source clip does.

        Args:
            crop: on the recording's clip clock; None: the whole recording.
        """
        if crop is None:
            return
        first_ns = self.start_ns + seconds_to_ns(crop.start_s)
        last_ns = self.start_ns + seconds_to_ns(crop.end_s)
        self._frames = self._frames.within(first_ns, last_ns)
        self._states = self._states.within(first_ns, last_ns)
        self.crop = crop
        self.forget_questions()

    def forget_questions(self) -> None:
        """Free the memory of questions, once all models were asked.

        Those under the rules that were used last are kept as far as there is room: models with the
        same rules are asked the same, one after the other.
        """
        self._question_cache.clear()

    def _question(self, label_t_s: float, rules: Preprocessing) -> Question | NoQuestion:
        label_ns = self.start_ns + seconds_to_ns(label_t_s)
        newest = bisect_right(self._frames.stamps_ns, label_ns) - 1
        if newest < 0:
            return NoQuestion(label_t_s, "there is no frame at or before the label's time")
        stamp = self._frames.stamps_ns[newest]
        age_s = ns_to_seconds(label_ns - stamp)
        # METHOD 6.1: a record further from its label than this could not be matched.
        if not DEFAULT.at_most(age_s, DEFAULT.match_window_s):
            limit_s = DEFAULT.match_window_s
            return NoQuestion(
                label_t_s, f"the newest frame is {age_s:.3f} s old, more than {limit_s} s"
            )
        history = self._history(stamp, rules)
        request = Request(
            request_id="",
            stamp_ns=stamp,
            frames=self._fetch(
                [self._frames[i] for i in choose(self._frames.stamps_ns, newest, rules)]
            ),
            camera=self.camera,
            history=history,
            ego_provenance=self._provenance.ego if history else "unknown",
            task=self.task,
        )
        return Question(label_t_s, ns_to_seconds(stamp - self.start_ns), request)

    def _fetch(self, entries: list[_Entry]) -> tuple[Frame, ...]:
        stamps_ns = {frame.stamp_ns for frame in entries}
        start_ns = min(frame.log_time_ns for frame in entries)
        stop_ns = max(frame.log_time_ns for frame in entries) + 1
        jpegs: dict[int, bytes] = {}
        for frame in Frames(self._bag, _IMAGE).jpegs(start_ns, stop_ns, stamps_ns):
            jpegs.setdefault(frame.stamp_ns, frame.data)
        return tuple(Frame(stamp, jpegs[stamp]) for stamp in sorted(jpegs))

    def _history(self, now_ns: int, rules: Preprocessing) -> tuple[EgoSample, ...]:
        """Return ego samples up to a time, oldest first; empty without a recent state."""
        if self._provenance.ego == "unknown":
            return ()
        newest = bisect_right(self._states.stamps_ns, now_ns) - 1
        if newest < 0:
            return ()
        reach_ns = seconds_to_ns(rules.history_s + rules.history_spacing_s)
        first = max(0, bisect_right(self._states.stamps_ns, now_ns - reach_ns) - 1)
        messages = self._fetch_states(first, newest)

        def state(index: int) -> ObjectState:
            return object_state(self._bag.decode(messages[self._states[index]]))

        return ego_history(self._states.stamps_ns, state, now_ns, rules)

    def _fetch_states(self, first: int, newest: int) -> dict[_Entry, BagMessage]:
        """Return the messages of these states and of those received between them."""
        log_times_ns = [self._states[index].log_time_ns for index in range(first, newest + 1)]
        messages = self._bag.messages([_VUT_STATE], min(log_times_ns), max(log_times_ns) + 1)
        return {_Entry(peek_stamp_ns(m.data), m.log_time_ns): m for m in messages}

    def close(self) -> None:
        self._stack.close()
