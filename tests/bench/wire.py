"""The codecs of the hot messages beside a bare unpacking of their numbers, and rclpy's messages."""

from __future__ import annotations

import struct
import timeit
from collections.abc import Callable

from measure import report
from rclpy.serialization import deserialize_message, serialize_message

from ssp_core.cdr import states
from ssp_core.cdr.messages import object_state
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.vocabulary import ControlState, ObjectClass, Role
from ssp_msgs.msg import ObjectState as ObjectStateMsg
from tests.support.bags.rclpy_messages import state_to_msg

OBJECTS = 20
REPEATS = 7


def a_state(number: int) -> ObjectState:
    return ObjectState(
        f"ot{number}",
        ObjectClass.CAR,
        Role.OT,
        1_234_567_890,
        12.3,
        4.5,
        0.6,
        7.8,
        0.9,
        0.01,
        DEFAULT_SIZES[ObjectClass.CAR],
        77,
        ControlState.RUNNING,
        0.02,
        f"ot{number}-3",
        0.1,
        0.2,
        0.003,
    )


def best_us(call: Callable[[], object], number: int) -> float:
    """The fastest of several rounds, which disturbances touch least."""
    return min(timeit.repeat(call, number=number, repeat=REPEATS)) / number * 1e6


def main() -> None:
    one = a_state(1)
    data, bare = states.encode_state(one), struct.Struct("<18d")
    numbers = bytes(bare.size)
    by_rclpy = best_us(lambda: object_state(deserialize_message(data, ObjectStateMsg)), 3000)
    report(
        "wire: decode a state",
        best_us(lambda: states.decode_state(data), 10_000),
        best_us(lambda: bare.unpack(numbers), 10_000),
        "us",
        f"{len(data)} bytes; through rclpy's message {by_rclpy:.1f} us",
        lower=True,
        ratio_limit=45.0,
    )
    by_rclpy = best_us(lambda: serialize_message(state_to_msg(one)), 3000)
    report(
        "wire: encode a state",
        best_us(lambda: states.encode_state(one), 10_000),
        best_us(lambda: bare.pack(*(0.0,) * 18), 10_000),
        "us",
        f"{len(data)} bytes; through rclpy's message {by_rclpy:.1f} us",
        lower=True,
    )
    array = states.StateArray(0, "object_target", tuple(map(a_state, range(1, OBJECTS + 1))))
    many = states.encode_states(array)
    report(
        "wire: decode the states of many",
        best_us(lambda: states.decode_states(many), 1000),
        best_us(lambda: [bare.unpack(numbers) for _ in range(OBJECTS)], 1000),
        "us",
        f"{OBJECTS} objects, {len(many)} bytes",
        lower=True,
        ratio_limit=28.0,
    )
    last = f"ot{OBJECTS}"
    report(
        "wire: find one state among many",
        best_us(lambda: states.find_state(many, last), 5000),
        best_us(lambda: states.decode_state(data), 5000),
        "us",
        f"{OBJECTS} objects; bound: decoding one that came by itself",
        lower=True,
    )


if __name__ == "__main__":
    main()
