"""Takes serialised messages through the C interface of rcl.

rclpy's own ``take_message`` is the same call, but it doesn't say which publisher a message is from,
and it allocates a buffer for each message, which for uncompressed frames takes longer than copying
them. Here one buffer serves all messages, and the publisher's id tells losses from a second
publisher.

The structures are those of rcl, rmw and rcutils in Jazzy; a test compares what is taken here with
what rclpy takes.
"""

from __future__ import annotations

import ctypes
import struct
from typing import TypeAlias

from ssp_core.errors import HostError

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
        """The memory of the buffer, which moves when it has to grow, and where it is."""
        where = int(self._buffer.buffer)
        self._room = (ctypes.c_char * self._buffer.capacity).from_address(where)
        self._room_at = where
        return self._room, where

    def close(self) -> None:
        """Frees the buffer."""
        self._free(ctypes.byref(self._buffer))

    def take(self, subscription: int) -> tuple[list[Taken], bool]:
        """What has arrived at a subscription, oldest first, and whether there may be more.

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
        taken: list[Taken] = []
        size = 0
        while size < BATCH_BYTES and len(taken) < BATCH_MESSAGES:
            result = take(subscription, buffer, info_at, None)
            if result != _OK:
                if result == _NOTHING_TAKEN:
                    return taken, False
                self._reset_error()
                self._refused = result
                if taken:
                    return taken, True
                raise HostError(f"a message can't be taken: rcl answers {result}")
            address, length = unpack_length(where)
            published_ns, received_ns, sequence, publisher = unpack_info(info)
            if sequence == _NO_NUMBER:
                sequence = 0
            if address != room_at or length > len(room):
                room, room_at = self._look_at_buffer()
            data: bytes = room[:length]  # type: ignore[assignment]  # of char it is bytes
            taken.append((data, published_ns, received_ns, sequence, publisher))
            size += length
        return taken, True
