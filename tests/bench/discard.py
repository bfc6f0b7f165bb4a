"""A subscriber that throws everything away: ``python discard.py LOAD``, until SIGINT.

It is an ordinary node of rclpy: the project's executor, serialised messages, and callbacks that
count them, which is the least that says whether everything came.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections import Counter
from functools import partial

import rclpy
from rclpy.signals import SignalHandlerOptions
from traffic import Load

from ssp_core import ros
from ssp_monitor.ros.conversions import message_class, recording_profile


def main(load: Load) -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = ros.make_node("bench_discard")
    counts: Counter[str] = Counter()

    def count(name: str, _: bytes) -> None:
        counts[name] += 1

    for topic in load.topics:
        cls, profile = message_class(topic.msgtype), recording_profile(topic.profile)
        node.create_subscription(cls, topic.name, partial(count, topic.name), profile, raw=True)
    over = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: over.set())
    executor = ros.make_executor()
    executor.add_node(node)
    while not over.is_set():
        executor.spin_once(timeout_sec=0.5)
    print(json.dumps(counts), flush=True)
    os._exit(0)


if __name__ == "__main__":
    main(Load(**json.loads(sys.argv[1])))
