"""A node that publishes what somebody else does in a session; started by a test beside one."""

from __future__ import annotations

import sys
from dataclasses import replace

import rclpy

from ssp_core import names, ros
from ssp_core.cdr.states import decode_state, encode_state
from ssp_msgs import msg


def main(topic: str) -> None:
    """Says another place of an object with each of its states, or is merely there.

    It joins the session's domain and publishes after a line on its input asks for it.
    """
    rclpy.init()
    node = ros.make_node("stranger")
    print("there", flush=True)
    sys.stdin.readline()
    if topic == names.STEP_DONE:
        node.create_publisher(msg.StepDone, topic, ros.STATE)
    else:
        forged = node.create_publisher(msg.ObjectState, topic, ros.STATE)

        def forge(data: bytes) -> None:
            state = decode_state(data)
            if (state.y_m * 1000) % 1 != 0.5:  # not one of ours
                y_m = round(state.y_m + 0.9, 3) + 0.0005
                forged.publish(encode_state(replace(state, y_m=y_m)))

        node.create_subscription(msg.ObjectState, topic, forge, ros.STATE, raw=True)
    executor = ros.make_executor()
    executor.add_node(node)
    while rclpy.ok():
        executor.spin_once(timeout_sec=0.2)


if __name__ == "__main__":
    main(sys.argv[1])
