"""Takes every message of the recorded topics as it came, serialised, outside any executor.

One thread looks every few milliseconds at all subscriptions and takes what has arrived, with the
middleware's times, the sequence number and the publisher's id. An EventsExecutor gives its
callbacks no such information, and losses are found by it. To be woken for each message would cost
more than to look: a message that waits some milliseconds in the middleware keeps its time of
arrival.
"""

from __future__ import annotations

import ctypes
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TypeAlias

import rclpy
from rclpy.event_handler import QoSSubscriptionEventType, UnsupportedEventTypeError
from rclpy.impl.implementation_singleton import rclpy_implementation as rcl
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from ssp_core import names
from ssp_core.bag.types import BagMessage
from ssp_core.errors import HostError
from ssp_core.ros import take_the_rest
from ssp_monitor.recorder.losses import SOURCES, Arrivals, SimulatedTime, claims, stamp_at
from ssp_monitor.recorder.recorder import Recorder
from ssp_monitor.recorder.topics import Importance, TopicSpec, importance
from ssp_monitor.ros.conversions import message_class, recording_profile
from ssp_monitor.ros.parameters import topic_rules

_OK = 0
_NOTHING_TAKEN = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED
_NO_NUMBER = (1 << 64) - 1  # RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED
_FIRST_BYTES = 1 << 16
# Handed over at once, so that a reader that fell behind doesn't hold all of it twice.
BATCH_MESSAGES = 256
BATCH_BYTES = 8 << 20


# One message as it was sent; a plain tuple, since a named one takes longer to make than to take.
# - the message with its encapsulation
# - the publisher's time, ns
# - when it arrived at this process, which is before it was taken, ns
# - the publisher's number for it, from 1; 0 where the middleware has none
# - what tells its publisher from others
Taken: TypeAlias = tuple[bytes, int, int, int, bytes]


class _Allocator(ctypes.Structure):
    """rcutils_allocator_t: four functions and a state."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("a", "d", "r", "z", "state")]


class _Buffer(ctypes.Structure):
    """rcl_serialized_message_t, which is rcutils_uint8_array_t."""

    _fields_ = [
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


# rmw_message_info_t up to what is read of it: times of sending and arrival, the numbers that
# publisher and subscription give, who implements the publisher's id, and the id.
_INFO = struct.Struct("=qqQ8x8x16s")
_INFO_ROOM_BYTES = 256  # the structure takes 64
_LENGTH = struct.Struct("=QQ")


class SerializedTaker:
    """Takes messages out of subscriptions, in one thread.

    Raises:
        HostError: the libraries that rclpy stands on were not found.
    """

    def __init__(self) -> None:
        try:
            # Calls keep the interpreter's lock. To give it up and to ask for it again for every
            # message would let each of them wait for the thread that writes.
            rcl, rcutils = ctypes.PyDLL("librcl.so"), ctypes.PyDLL("librcutils.so")
        except OSError as error:
            raise HostError(f"a library of ROS 2 can't be loaded: {error}") from error
        self._take = rcl.rcl_take_serialized_message
        self._take.argtypes = [ctypes.c_void_p] * 4
        self._reset_error = rcutils.rcutils_reset_error
        self._reset_error.restype = None
        self._free = rcutils.rcutils_uint8_array_fini
        self._free.argtypes = [ctypes.c_void_p]
        rcutils.rcutils_get_default_allocator.restype = _Allocator
        self._buffer = _Buffer(allocator=rcutils.rcutils_get_default_allocator())
        make = rcutils.rcutils_uint8_array_init
        make.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]
        allocator = ctypes.byref(self._buffer, _Buffer.allocator.offset)
        if make(ctypes.byref(self._buffer), _FIRST_BYTES, allocator) != _OK:
            raise HostError(f"no memory for a buffer of {_FIRST_BYTES} bytes")
        self._info = ctypes.create_string_buffer(_INFO_ROOM_BYTES)
        self._room, self._room_at = self._look_at_buffer()
        self._refused: int | None = None

    def _look_at_buffer(self) -> tuple[ctypes.Array[ctypes.c_char], int]:
        """Return the memory of the buffer, which moves when it has to grow, and its address."""
        where = int(self._buffer.buffer)
        self._room = (ctypes.c_char * self._buffer.capacity).from_address(where)
        self._room_at = where
        return self._room, where

    def close(self) -> None:
        """Free the buffer."""
        self._free(ctypes.byref(self._buffer))

    def take(self, subscription: int) -> tuple[list[Taken], bool]:
        """Take the messages that arrived, oldest first, and tell whether more may come.

        Args:
            subscription: address of its rcl_subscription_t, which must stay valid meanwhile.

        Raises:
            HostError: the middleware refuses; what it gave before is returned first, and the next
                call raises.
        """
        if self._refused is not None:
            raise HostError(f"a message can't be taken: rcl answers {self._refused}")
        take, buffer, info = self._take, ctypes.addressof(self._buffer), self._info
        info_at = ctypes.addressof(info)
        unpack_length, unpack_info = _LENGTH.unpack_from, _INFO.unpack_from
        where, room, room_at = self._buffer, self._room, self._room_at
        raw_messages: list[Taken] = []
        size = 0
        while size < BATCH_BYTES and len(raw_messages) < BATCH_MESSAGES:
            result = take(subscription, buffer, info_at, None)
            if result != _OK:
                if result == _NOTHING_TAKEN:
                    return raw_messages, False
                self._reset_error()
                self._refused = result
                if raw_messages:
                    return raw_messages, True
                raise HostError(f"a message can't be taken: rcl answers {result}")
            address, length = unpack_length(where)
            published_ns, received_ns, sequence, publisher = unpack_info(info)
            if sequence == _NO_NUMBER:
                sequence = 0
            if address != room_at or length > len(room):
                room, room_at = self._look_at_buffer()
            data: bytes = room[:length]  # type: ignore[assignment]  # of char it is bytes
            raw_messages.append((data, published_ns, received_ns, sequence, publisher))
            size += length
        return raw_messages, True


# Between two looks. In lockstep the world waits for the recorder when it is 20 steps behind.
PAUSE_S = 0.020
LOCKSTEP_PAUSE_S = 0.004
# A topic that was silent for so many looks is looked at in turn with others, so that ten thousand
# silent topics cost little: each look takes one of so many parts of them.
QUIET_LOOKS = 50
QUIET_PARTS = 10
# How often the middleware is asked what it could not deliver.
LOSSES_S = 1.0
# While a session waits, a picture in so many ns is enough: nothing of it is ever scored.
WAITING_PERIOD_NS = 1_000_000_000
_PICTURES = (Importance.RAW_IMAGE, Importance.COMPRESSED_IMAGE, Importance.FRAME)


@dataclass(slots=True)
class _Source:
    """One subscription and what came through it."""

    topic: TopicSpec
    subscription: Subscription
    address: int
    stamp_at: int | None
    listen: Callable[[bytes], None] | None
    lost_event: rcl.EventHandle | None
    arrivals: Arrivals = field(default_factory=Arrivals)
    quiet: int = 0
    complained: bool = False
    last: bytes = b""
    is_picture: bool = False
    picture_ns: int = 0
    passed_over: int = 0


class RecordingSubscriptions:
    """Takes every message of the topics, in a thread, and hands it to the recorder.

    Args:
        topics: what to subscribe to, with the project's own profiles.
        simulated_time: messages are dated by their own stamps; otherwise by the middleware's
            times of reception and publication.
        listen: takes the bytes of messages of some topics as they are recorded, in that thread.
        is_waiting: whether a live session waits for its start; of pictures few are kept then.
    """

    def __init__(
        self,
        topics: tuple[TopicSpec, ...],
        recorder: Recorder,
        simulated_time: bool,
        listen: Mapping[str, Callable[[bytes], None]],
        is_waiting: Callable[[], bool] = lambda: False,
    ) -> None:
        self.time = SimulatedTime()
        self.error: BaseException | None = None
        self._listen = listen
        self._is_waiting = is_waiting
        self._recorder = recorder
        self._simulated_time = simulated_time
        self._pause_s = LOCKSTEP_PAUSE_S if simulated_time else PAUSE_S
        self._taker = SerializedTaker()
        # A node of its own, since an executor takes the messages of all subscriptions of a node
        # that it spins; of the process's arguments, which rename every node, it takes those that
        # say where a topic is to be heard. It is recorded under its own name all the same.
        self._node = rclpy.create_node(
            f"{names.MONITOR}_intake",
            namespace=names.NAMESPACE,
            use_global_arguments=False,
            cli_args=topic_rules(sys.argv),
            enable_rosout=False,
            start_parameter_services=False,
        )
        # Whoever adds a topic makes its subscription, and is told when that fails; the thread
        # fetches it from here.
        self._added: deque[_Source] = deque()
        self._arrivals: dict[str, Arrivals] = {}
        self._sources: list[_Source] = []
        for topic in topics:
            self.add(topic, recording_profile(topic.profile))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="intake", daemon=True)
        self._thread.start()

    def add(self, topic: TopicSpec, profile: QoSProfile) -> None:
        """Take in one more topic, from now on; from one thread at a time.

        Args:
            topic: not taken yet; the recorder knows it.
            profile: that its reader asks for.

        Raises:
            HostError: this ROS installation lacks its type.
            ValueError: it is taken already.
        """
        if topic.name in self._arrivals:
            raise ValueError(f"topic {topic.name} is taken already")
        subscription = self._node.create_subscription(
            message_class(topic.msgtype), topic.name, lambda _: None, profile, raw=True
        )
        source = _Source(
            topic,
            subscription,
            subscription.handle.pointer,
            stamp_at(topic.msgtype) if topic.session_time else None,
            self._listen.get(topic.name),
            _lost_event(subscription),
            is_picture=importance(topic) in _PICTURES,
        )
        # New dictionaries, since other threads go through the old ones.
        self._arrivals = {**self._arrivals, topic.name: source.arrivals}
        self._added.append(source)

    def lost_by_topic(self) -> dict[str, int]:
        """Count messages of each topic that were published and never arrived, as far as known."""
        return {name: arrivals.lost for name, arrivals in self._arrivals.items()}

    def returned_by_topic(self) -> dict[str, int]:
        """Count how often a publisher of each topic spoke again after another one had."""
        return {name: arrivals.returned for name, arrivals in self._arrivals.items()}

    def received_by_topic(self) -> dict[str, int]:
        """Count messages of each topic that arrived."""
        return {name: arrivals.received for name, arrivals in self._arrivals.items()}

    def passed_over_by_topic(self) -> dict[str, int]:
        """Count pictures of each topic that came while the session waited, and weren't kept."""
        return {s.topic.name: s.passed_over for s in self._sources if s.passed_over}

    def stop(self) -> None:
        """Take what has arrived and what is under way, and end."""
        self._stop.set()
        self._thread.join()
        self._taker.close()
        self._node.destroy_node()

    # -- the thread ----------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            with ExitStack() as handles:
                sources = self._sources
                ask_at = time.monotonic() + LOSSES_S
                part = 0
                while not self._stop.is_set():
                    self._fetch_added(handles)
                    part = (part + 1) % QUIET_PARTS
                    for index, source in enumerate(sources):
                        if source.quiet < QUIET_LOOKS or index % QUIET_PARTS == part:
                            self._take_all(source)
                    if time.monotonic() >= ask_at:
                        _ask_losses(sources)
                        ask_at = time.monotonic() + LOSSES_S
                    time.sleep(self._pause_s)
                self._fetch_added(handles)
                self._take_the_rest()
        except BaseException as error:
            self.error = error
            raise

    def _fetch_added(self, handles: ExitStack) -> None:
        while self._added:
            source = self._added.popleft()
            handles.enter_context(source.subscription.handle)
            if source.lost_event is not None:
                handles.enter_context(source.lost_event)
            self._sources.append(source)

    def _take_all(self, source: _Source) -> bool:
        """Take all that arrived, and tell whether there was anything."""
        source.quiet += 1
        more = True
        while more:
            raw_messages, more = self._taker.take(source.address)
            if not raw_messages:
                break
            source.quiet = 0
            self._hand_over(source, raw_messages)
        return source.quiet == 0

    def _hand_over(self, source: _Source, raw_messages: list[Taken]) -> None:
        topic, register = source.topic.name, source.arrivals.note
        for _, _, _, sequence, publisher in raw_messages:
            register(publisher, sequence)
        if source.is_picture and self._is_waiting():
            raw_messages = _thinned(source, raw_messages)
        if self._simulated_time:
            date, at = self.time.of, source.stamp_at
            messages = []
            for data, _, _, sequence, _ in raw_messages:
                now_ns = date(data, at)
                messages.append(BagMessage(topic, now_ns, now_ns, data, sequence))
        else:
            # A publisher's clock may stand before 1970; the bag has no such times.
            messages = [
                BagMessage(topic, max(received_ns, 0), max(published_ns, 0), data, sequence)
                for data, published_ns, received_ns, sequence, _ in raw_messages
            ]
        self._recorder.put_all(messages)
        if source.listen is not None:
            self._tell(source, source.listen, raw_messages)
        if topic in SOURCES and raw_messages:
            source.last = raw_messages[-1][0]

    def _tell(
        self, source: _Source, listen: Callable[[bytes], None], raw_messages: list[Taken]
    ) -> None:
        """Tell a listener of messages of any sender; its failure must not end the recording."""
        for one in raw_messages:
            try:
                listen(one[0])
            except Exception as error:
                if not source.complained:
                    source.complained = True
                    self._node.get_logger().error(
                        f"{source.topic.name}: message recorded and not understood (more will be "
                        f"without a word): {type(error).__name__}: {error}"
                    )

    def _take_the_rest(self) -> None:
        sources = self._sources
        take_the_rest(lambda: sum(map(self._take_all, sources)) > 0)
        _ask_losses(sources)
        last = {source.topic.name: source.last for source in sources if source.last}
        for topic, sent in claims(last).items():
            if topic in self._arrivals:
                self._arrivals[topic].claimed(sent)


def _thinned(source: _Source, raw_messages: list[Taken]) -> list[Taken]:
    """Return the pictures that are kept of a session that waits; the others are counted."""
    pictures = []
    for one in raw_messages:
        if one[2] - source.picture_ns >= WAITING_PERIOD_NS:
            source.picture_ns = one[2]
            pictures.append(one)
    source.passed_over += len(raw_messages) - len(pictures)
    return pictures


def _lost_event(subscription: Subscription) -> rcl.EventHandle | None:
    """Return the middleware's count of what it could not deliver, None where it has none."""
    try:
        with subscription.handle:
            return rcl.EventHandle(
                subscription.handle, QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
            )
    except UnsupportedEventTypeError:
        return None


def _ask_losses(sources: list[_Source]) -> None:
    for source in sources:
        if source.lost_event is not None:
            status = source.lost_event.take_event()
            if status is not None:
                source.arrivals.middleware_losses = status.total_count
