"""Messages past rclpy's own conversion: what is none is dropped and told of once."""

from __future__ import annotations

from types import SimpleNamespace

from ssp_core import ros
from ssp_core.cdr.steps import StepDone, decode_done, encode_done


class FakeNode:
    """Takes the subscription, and gives what arrives on it to the callback."""

    def __init__(self) -> None:
        self.errors: list[str] = []
        self.raw = False

    def create_subscription(self, kind, topic, callback, qos, *, raw):
        self.deliver, self.raw = callback, raw

    def get_logger(self):
        return SimpleNamespace(error=self.errors.append)


def test_broken_messages_are_dropped_and_told_of_once():
    node, taken = FakeNode(), []
    ros.subscribe_raw(node, object, "world/step_done", decode_done, taken.append, ros.STATE)
    done = StepDone("object_target", 7)
    node.deliver(b"")
    node.deliver(encode_done(done))
    node.deliver(encode_done(done)[:-1])
    assert node.raw
    assert taken == [done]
    assert len(node.errors) == 1
    assert node.errors[0].startswith("world/step_done: message dropped")
