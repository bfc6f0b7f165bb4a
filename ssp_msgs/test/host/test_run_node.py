"""One node in a process: how it ends, what it says, and that it can say its last words."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest

from ssp_core import ros
from ssp_core.cdr.steps import StepDone, decode_done, encode_done
from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_core.host.shared_memory import remove_shared_ports, remove_stale_shared_memory
from tests.support.processes.waiting import DEADLINE_S

pytestmark = pytest.mark.ros

PROGRAM = """
import sys
import time
import rclpy
from rclpy.node import Node
from ssp_core.errors import HostError, InputError
from ssp_core.ros import STATE, run_node
from std_msgs.msg import String

kind = sys.argv[1]

class Probe(Node):
    def __init__(self, stop):
        if kind == "bad_input":
            raise InputError("is wrong", file="a.yaml", field="x", value=[1])
        if kind == "bug_at_start":
            raise RuntimeError("a bug")
        super().__init__("probe")
        self._stop = stop
        topics = 16 if kind == "publishes" else 0
        self.many = [self.create_publisher(String, f"many_{k}", STATE) for k in range(topics)]
        self.create_timer(0.05, self._work)
        print("up", flush=True)

    def _work(self):
        if kind == "asks":
            self._stop.set("enough")
        if kind == "publishes" and all(p.get_subscription_count() == 2 for p in self.many):
            print("matched", flush=True)
            sys.stdin.readline()
            for number in range(34):
                for publisher in self.many:
                    publisher.publish(String(data=str(number)))
            self._stop.set("all published")
        if kind == "bug":
            raise RuntimeError("a bug")
        if kind == "host":
            raise HostError("this machine lacks something")

    def destroy_node(self):
        if kind == "hangs_at_the_end":
            time.sleep(60.0)
        super().destroy_node()

def shutdown(node):
    # The context must still be valid here, or a node could not publish its stop.
    print("last words", rclpy.ok(), flush=True)
    if kind == "bug_at_end":
        raise RuntimeError("a bug at the end")

sys.exit(run_node(Probe, shutdown))
"""

READER = """
import rclpy
from ssp_core import ros
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node("reader")
heard = []
for k in range(16):
    node.create_subscription(String, f"many_{k}", heard.append, ros.STATE)
while not heard or node.count_publishers("many_0"):
    rclpy.spin_once(node, timeout_sec=0.1)
ros.take_the_rest(lambda: any([ros.take_arrived(one) for one in node.subscriptions]))
print(len(heard), flush=True)
"""


@pytest.fixture
def probe() -> Iterator[Callable[[str], subprocess.Popen[str]]]:
    with free_domain() as domain_id:

        def start(kind: str, program: str = PROGRAM) -> subprocess.Popen[str]:
            return subprocess.Popen(
                [sys.executable, "-c", program, kind],
                env=session_environment(domain_id),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )

        yield start
        remove_shared_ports(domain_id)
    remove_stale_shared_memory()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_is_an_orderly_end(
    probe: Callable[[str], subprocess.Popen[str]], number: signal.Signals
) -> None:
    process = probe("waits")
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    process.send_signal(number)
    out, err = process.communicate(timeout=DEADLINE_S)
    assert (process.returncode, out, err) == (0, "last words True\n", "")


def test_middleware_that_hangs_is_left_once_the_node_has_closed_what_it_had_to(
    probe: Callable[[str], subprocess.Popen[str]],
) -> None:
    process = probe("hangs_at_the_end")
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    process.terminate()
    out, err = process.communicate(timeout=DEADLINE_S)
    assert out == "last words True\n"
    assert process.returncode == 1
    assert "Timeout" in err
    assert "destroy_node" in err  # where it hung


def test_readers_get_all_that_was_published_and_one_that_hangs_delays_the_end_by_two_seconds(
    probe: Callable[..., subprocess.Popen[str]],
) -> None:
    """A little more is published than the 512 that a port in shared memory holds of what isn't
    taken out: the rest has to be sent again."""
    writer, *readers = probe("publishes"), probe("waits", READER), probe("hangs", READER)
    assert writer.stdin is not None
    assert writer.stdout is not None
    try:
        assert [writer.stdout.readline() for _ in range(2)] == ["up\n", "matched\n"]
        for reader in readers:
            reader.send_signal(signal.SIGSTOP)
        began = time.monotonic()
        writer.stdin.write("\n")
        writer.stdin.flush()
        assert writer.stdout.readline() == "last words True\n"
        readers[0].send_signal(signal.SIGCONT)
        assert readers[0].communicate(timeout=DEADLINE_S) == ("544\n", "")
        assert writer.wait(timeout=DEADLINE_S) == 0
        assert time.monotonic() - began >= ros.LAST_WORD_S
    finally:
        for process in (writer, *readers):
            process.kill()
            process.communicate()


def test_a_node_can_ask_for_its_end(probe: Callable[[str], subprocess.Popen[str]]) -> None:
    process = probe("asks")
    out, _ = process.communicate(timeout=DEADLINE_S)
    assert (process.returncode, out) == (0, "up\nlast words True\n")


@pytest.mark.parametrize(
    ("kind", "err", "out"),
    [
        ("bad_input", "error: a.yaml: x: is wrong (got [1])\n", ""),
        ("host", "error: this machine lacks something\n", "up\nlast words True\n"),
    ],
)
def test_an_error_of_ours_is_one_message(
    probe: Callable[[str], subprocess.Popen[str]], kind: str, err: str, out: str
) -> None:
    process = probe(kind)
    said, complained = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 1
    assert said == out
    # The executor may log beforehand from which callback it comes.
    assert complained.endswith(err)
    assert complained.count("error: ") == 1
    assert "Traceback" not in complained


@pytest.mark.parametrize("kind", ["bug_at_start", "bug", "bug_at_end"])
def test_a_bug_is_a_traceback_and_a_failure(
    probe: Callable[[str], subprocess.Popen[str]], kind: str
) -> None:
    process = probe(kind)
    if kind == "bug_at_end":
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        process.terminate()
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 1
    assert "Traceback" in err
    assert "RuntimeError: a bug" in err
    assert ("last words True" in out) == (kind != "bug_at_start")


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
