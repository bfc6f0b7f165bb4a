"""A user's own bridge that does what its script says, one word per request: a real node.

Run as ``python -m fake_bridge --ros-args -p model:=NAME -p script:=twice,die,…``; like a node that
launch respawns, it is started again when it dies, and goes on in its script.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from array import array
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from ssp_core.host.children import die_with_parent
from ssp_msgs.msg import NativeArray, VlaRequest, VlaResponse

DIED = 3
HUNG_S = 5.0
# Larger than an answer may be, and no test of how fast the middleware is.
HUGE = 2_000_000
FLOOD = 2000
RELIABLE = QoSProfile(depth=4, reliability=ReliabilityPolicy.RELIABLE)
HTML = "<html><head><title>502 Bad Gateway</title></head><body>nginx</body></html>"


class FakeBridge(Node):  # type: ignore[misc]  # rclpy has no types
    """Answers one request after the other, each as the script says."""

    def __init__(self) -> None:
        super().__init__("fake_bridge")
        self.model = str(self.declare_parameter("model", "mine").value)
        self.script = str(self.declare_parameter("script", "").value).split(",")
        self.count = Path(str(self.declare_parameter("count", "").value))
        topic = f"/ssp/vla/{self.model}"
        self.publisher = self.create_publisher(VlaResponse, f"{topic}/response", RELIABLE)
        self.create_subscription(VlaRequest, f"{topic}/request", self.on_request, RELIABLE)

    def on_request(self, request: Any) -> None:
        # A node that was just started again isn't known to who asked, and its answer isn't kept.
        while rclpy.ok() and self.publisher.get_subscription_count() == 0:
            time.sleep(0.005)
        index = int(self.count.read_text()) if self.count.exists() else 0
        self.count.write_text(str(index + 1))
        word = self.script[index] if index < len(self.script) else "answer"
        getattr(self, word)(self.plain(request))

    def plain(self, request: Any) -> Any:
        """A good answer: 8 m/s straight on."""
        points = [value for k in range(5) for value in (4.0 * k, 0.0)]
        plan = NativeArray(name="trajectory", shape=[5, 2], data=array("d", points))
        plan.frame, plan.unit, plan.step = "ego_xy", "m", 0.5
        answer = VlaResponse(request_id=request.request_id, model=self.model, model_id="fake/1")
        answer.header.stamp = request.header.stamp
        answer.text, answer.arrays = "A car is ahead. I keep my speed.", [plan]
        answer.decoding = json.dumps({"temperature": 0})
        return answer

    def answer(self, answer: Any) -> None:
        self.publisher.publish(answer)

    def hang(self, answer: Any) -> None:
        time.sleep(HUNG_S)
        self.publisher.publish(answer)

    def die(self, answer: Any) -> None:
        os._exit(DIED)

    def leave(self, answer: Any) -> None:
        """Dies with a farewell, so that its topics are known to be empty at once."""
        self.destroy_node()
        rclpy.shutdown()
        os._exit(DIED)

    def twice(self, answer: Any) -> None:
        self.publisher.publish(answer)
        answer.text = "No, I stop."
        self.publisher.publish(answer)

    def other(self, answer: Any) -> None:
        answer.request_id = "somebody-else-s"
        self.publisher.publish(answer)

    def garbage(self, answer: Any) -> None:
        answer.decoding = "temperature=0; {"
        self.publisher.publish(answer)

    def deep(self, answer: Any) -> None:
        answer.decoding = '{"a":' * 100_000
        self.publisher.publish(answer)

    def nan_decoding(self, answer: Any) -> None:
        answer.decoding = '{"top_p": NaN}'
        self.publisher.publish(answer)

    def nan(self, answer: Any) -> None:
        answer.arrays[0].data = array("d", [float("nan")] * 10)
        self.publisher.publish(answer)

    def html(self, answer: Any) -> None:
        answer.text, answer.arrays = HTML, []
        self.publisher.publish(answer)

    def huge(self, answer: Any) -> None:
        answer.text = "a" * HUGE
        self.publisher.publish(answer)

    def flood(self, answer: Any) -> None:
        mine, answer.request_id = answer.request_id, "nobody-s"
        for _ in range(FLOOD):
            self.publisher.publish(answer)
        answer.request_id = mine
        self.publisher.publish(answer)


def main() -> int:
    """Runs the node in a child; a node that died is started again."""
    if os.environ.get("FAKE_BRIDGE_CHILD") != "1":
        environment = {**os.environ, "FAKE_BRIDGE_CHILD": "1"}
        command = [sys.executable, "-m", "fake_bridge", *sys.argv[1:]]
        while True:
            ended = subprocess.run(
                command, env=environment, preexec_fn=die_with_parent, check=False
            )
            if ended.returncode != DIED:
                return ended.returncode
    # Its parent's death ends it at once, whatever it hangs in.
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    rclpy.spin(FakeBridge())
    return 0


if __name__ == "__main__":
    sys.exit(main())
