"""The bag of a twin: the factual one's messages, those of the cause replaced."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

from ssp_core import __version__
from ssp_core.bag.operations.derived import begin_derived
from ssp_core.bag.reading.reader import BagReader, content_sha256
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing.chain import Maker
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.codec import u32_bytes
from ssp_core.cdr.images import COMPRESSED_TYPE, read_image
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.cdr.states import StateArray, decode_state, decode_states, encode_state, encode_states
from ssp_core.cdr.steps import decode_tick, encode_tick
from ssp_core.errors import InputError
from ssp_core.files.folders import new_folder
from ssp_core.files.writing import write_json
from ssp_core.motion.state import ObjectState
from ssp_core.names import OBJECT_STATES, TF, absolute, state_topic
from ssp_core.run_file.verdict import VERDICT_FILE
from ssp_core.world.transforms import (
    Transform,
    base_frame,
    decode_transforms,
    encode_transforms,
    of_state,
)
from ssp_eval.data.provenance import bag_folder
from ssp_eval.twins.audit import Pixels, audit_of
from ssp_eval.twins.changes import MOVED, Change, Kind, Series, changed_state, slowed
from ssp_eval.twins.files import (
    TWIN_FILE,
    TwinIdentity,
    TwinRecord,
    bag_of,
)
from ssp_eval.twins.playback import IMAGE, TICK, Factual, Picture, World, decoded, draw

ARRAYS = absolute(OBJECT_STATES)
# So many twins are made at once: the factual frames are drawn once for all of them, and what an
# interruption loses stays small.
TOGETHER = 4


def make_twins(
    factual: Factual,
    bag: BagReader,
    changes: Sequence[Change],
    advance: Callable[[], None] = lambda: None,
) -> list[TwinRecord]:
    """Make twins beside a recording, each whole or not there.

    Args:
        factual: the recording.
        bag: of ``factual``.
        changes: none of which has a folder there.
        advance: called for each frame of each twin.

    Raises:
        InputError: a change doesn't fit the recording, or its frames drawn anew don't have the
            recorded bytes.
        HostError: the disk doesn't take it.
    """
    edits = [_Edit(factual, bag, change) for change in changes]
    with ExitStack() as stack:
        folders = [
            stack.enter_context(new_folder(bag_of(bag.path, change.name).parent))
            for change in changes
        ]
        writers = [
            stack.enter_context(BagWriter(folder / "bag", maker=Maker.TWIN)) for folder in folders
        ]
        for edit, writer in zip(edits, writers, strict=True):
            edit.begin(writer)
        with closing(_Frames(factual, edits)) as frames:
            for message in bag.messages():
                pictures = None
                if message.topic == IMAGE:
                    pictures = frames.of(message)
                for index, (edit, writer) in enumerate(zip(edits, writers, strict=True)):
                    picture = None if pictures is None else pictures[index]
                    data = edit.data(message, picture)
                    if data is not None:
                        writer.write_all([message._replace(data=data)])
                    if message.topic == IMAGE:
                        advance()
        twins = []
        for edit, writer, folder in zip(edits, writers, folders, strict=True):
            writer.close()
            verdict_file = bag_folder(bag.path) / VERDICT_FILE
            if verdict_file.is_file():
                shutil.copyfile(verdict_file, folder / "bag" / VERDICT_FILE)
            record = edit.record(folder / "bag")
            write_json(folder / TWIN_FILE, record.model_dump(mode="json", by_alias=True))
            twins.append(record)
    return twins


class _Frames:
    """The pictures of recorded frames, drawn as they are asked for.

    Args:
        edits: those of changes of frames get a picture, the others None.
    """

    def __init__(self, factual: Factual, edits: Sequence[_Edit]) -> None:
        self._factual, self._edits = factual, edits
        self._drawing = [edit for edit in edits if edit.draws]
        worlds = [World(factual, None), *(edit.world for edit in self._drawing)]
        self._drawings = draw(factual, worlds) if self._drawing else None
        self._pictures: dict[int, list[Picture]] = {}

    def of(self, message: BagMessage) -> list[Picture | None]:
        """Return the pictures of a recorded frame, one for each edit.

        Raises:
            InputError: the factual one drawn anew hasn't the recorded bytes.
        """
        if self._drawings is None:
            return [None] * len(self._edits)
        stamp_ns = peek_stamp_ns(message.data)
        while stamp_ns not in self._pictures:
            drawing = next(self._drawings, None)
            if drawing is None:
                raise self._unlike(stamp_ns, "there is no step of the world for it")
            # What was drawn and not asked for isn't asked for later: frames come in order.
            self._pictures = {drawing[0]: drawing[1]}
        # Each message: while the world holds, the same frame comes repeatedly.
        self._take(message, stamp_ns, self._pictures[stamp_ns])
        pictures = iter(self._pictures[stamp_ns][1:])
        return [next(pictures) if edit.draws else None for edit in self._edits]

    def _take(self, message: BagMessage, stamp_ns: int, pictures: list[Picture]) -> None:
        recorded = read_image(COMPRESSED_TYPE, message.data).data
        if recorded != pictures[0].jpeg:
            raise self._unlike(stamp_ns, "drawn anew it doesn't have the recorded bytes")
        for edit, picture in zip(self._drawing, pictures[1:], strict=True):
            edit.pixels.take(edit.world, pictures[0], picture)

    def _unlike(self, stamp_ns: int, why: str) -> InputError:
        return InputError(
            f"has a frame of which no twin can be made: {why}, so that a difference could come "
            "from the drawing",
            file=self._factual.path,
            field=IMAGE,
            value=f"{stamp_ns / 1e9:g} s",
            remedy="another version of the project or another kind of machine drew it: record the "
            "run again here, with `ssp run RUN --out NEW`",
        )

    def close(self) -> None:
        """End the drawing."""
        self._pictures = {}


class _Edit:
    """The edit of each message of the factual bag in one twin."""

    def __init__(self, factual: Factual, bag: BagReader, change: Change) -> None:
        self._factual, self._bag, self.change = factual, bag, change
        self.world = World(factual, change)
        self.draws = change.kind is not Kind.HISTORY
        self.pixels = Pixels(change.object_id)
        # Whose reported states differ, if anybody's.
        self._who = ""
        if change.kind in MOVED:
            self._who = change.object_id
        elif change.kind is Kind.HISTORY:
            self._who = factual.run.vut.id
        self._own_topic = absolute(state_topic(self._who)) if self._who else ""
        self._recorded: Series | None = None
        self._reported: Series | None = None
        if self._who:
            states = self._reported_states()
            self._recorded = Series(states) if states else None
            slow = slowed(states, change.value) if change.kind is Kind.HISTORY else states
            self._reported = Series(slow) if slow else None

    def _reported_states(self) -> list[ObjectState]:
        """Return the states that the object itself sent; none: it sends none, as traffic does."""
        own_states = []
        for message in self._bag.messages([self._own_topic, ARRAYS]):
            if message.topic == ARRAYS:
                states = decoded(self._bag, message, decode_states).states
                own_states += [state for state in states if state.object_id == self._who]
            else:
                own_states.append(decoded(self._bag, message, decode_state))
        return own_states

    def begin(self, writer: BagWriter) -> None:
        """Announce the topics, and attach what the factual bag holds and what the twin is."""
        identity = self.identity.model_dump_json(by_alias=True, indent=1).encode() + b"\n"
        begin_derived(writer, self._bag, {TWIN_FILE: identity})

    @property
    def identity(self) -> TwinIdentity:
        """Return the identity of the twin."""
        change, facts = self.change, self._factual.provenance
        return TwinIdentity(
            name=change.name,
            kind=change.kind.value,
            object_id=change.object_id,
            object_class=None if change.object_class is None else change.object_class.word,
            value=change.value,
            words=change.words,
            of=self._factual.run.run_id,
            of_sha256=facts.bag_sha256,
            seed=self._factual.run.seed,
            software=f"ssp {__version__}",
        )

    def record(self, twin_path: Path) -> TwinRecord:
        """Return the finished twin, compared with the factual bag."""
        with BagReader(twin_path) as twin:
            audit = audit_of(self.change, self._bag, twin, self.pixels)
            return TwinRecord(identity=self.identity, audit=audit, bag_sha256=content_sha256(twin))

    def data(self, message: BagMessage, picture: Picture | None) -> bytes | None:
        """Return the bytes of a message in the twin; None: the twin lacks it.

        Args:
            message: of the factual bag.
            picture: of the twin, for a frame; None: the recorded one stays.
        """
        topic, data = message.topic, message.data
        if topic == IMAGE:
            return data if picture is None else _with_jpeg(data, picture.jpeg)
        if topic == TICK:
            return self._tick(data)
        if self._reported is None:
            return data
        if topic == ARRAYS:
            return self._array(decoded(self._bag, message, decode_states), data)
        if topic == TF:
            return self._poses(decoded(self._bag, message, decode_transforms), data)
        if topic == self._own_topic:
            state = decoded(self._bag, message, decode_state)
            now = self._changed(state)
            return data if now == state else None if now is None else encode_state(now)
        return data

    def _changed(self, state: ObjectState) -> ObjectState | None:
        """Return a state of the object in the twin."""
        if self._reported is None:
            return state
        if self.change.kind is Kind.HISTORY:
            return replace(self._reported.at(state.stamp_ns), sequence=state.sequence)
        return changed_state(self.change, state, self._reported, self._factual.vut)

    def _tick(self, data: bytes) -> bytes:
        tick = decode_tick(data)
        objects = self.world.truth(tick)
        return data if objects == tick.objects else encode_tick(replace(tick, objects=objects))

    def _array(self, array: StateArray, data: bytes) -> bytes | None:
        changed = [self._changed(s) if s.object_id == self._who else s for s in array.states]
        left = tuple(state for state in changed if state is not None)
        if left == array.states:
            return data
        return encode_states(replace(array, states=left)) if left else None

    def _poses(self, poses: tuple[Transform, ...], data: bytes) -> bytes | None:
        left = [pose if pose.child != base_frame(self._who) else self._pose(pose) for pose in poses]
        new_poses = [pose for pose in left if pose is not None]
        if new_poses == list(poses):
            return data
        return encode_transforms(new_poses) if new_poses else None

    def _pose(self, pose: Transform) -> Transform | None:
        if self._recorded is None:
            return pose
        state = self._changed(self._recorded.at(pose.stamp_ns))
        return None if state is None else of_state(state)


def _with_jpeg(message: bytes, jpeg: bytes) -> bytes:
    """Return a CompressedImage with another picture; the picture is its last field."""
    recorded = bytes(read_image(COMPRESSED_TYPE, message).data)
    if recorded == jpeg:
        return message
    head = message[: message.rindex(recorded) - 4]
    return head + u32_bytes(len(jpeg)) + jpeg
