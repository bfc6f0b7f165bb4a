"""Bags: MCAP recordings that rosbag2, Foxglove and rosbags read, written and read without ROS."""

from ssp_core.bag.message import BagMessage
from ssp_core.bag.reader import BagReader, TopicInfo
from ssp_core.bag.recover import RecoverReport, recover
from ssp_core.bag.split import Split
from ssp_core.bag.states import object_states
from ssp_core.bag.writer import BagWriter

__all__ = [
    "BagMessage",
    "BagReader",
    "BagWriter",
    "RecoverReport",
    "Split",
    "TopicInfo",
    "object_states",
    "recover",
]
