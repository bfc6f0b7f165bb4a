"""The recorder's word of publishers that a session shouldn't have."""

from __future__ import annotations

from unittest.mock import MagicMock

from ssp_monitor.ros.monitor_node import LOOK_PERIOD_S, MonitorNode
from ssp_msgs.msg import RecorderStatus


def test_a_stranger_is_told_of_before_the_next_status_is_due() -> None:
    """The manager has a fifth of a second to name who speaks beside the session's own."""
    assert LOOK_PERIOD_S <= 0.05
    node = MagicMock(_reported_strangers=())
    node._publish_status.side_effect = lambda: MonitorNode._publish_status(node)
    node.recording.intake.error = node.recording.poll().ends = None
    told = "/ssp/ot1/state has messages of two publishers in turn"
    for strangers, statuses in (((), 0), ((told,), 1), ((told,), 1), ((), 2)):
        node.recording.present_strangers.return_value = strangers
        status = RecorderStatus(strangers=list(strangers))
        node.recording.status.return_value = status
        node.recording.intake.time.newest_ns = 0
        MonitorNode._tell_of_strangers(node)
        assert node._status.publish.call_count == statuses
    assert node._reported_strangers == ()
