"""Bags: MCAP recordings that rosbag2, Foxglove and rosbags read, written and read without ROS."""

from ssp_core.bag.reader import BagMessage, BagReader, TopicInfo
from ssp_core.bag.recover import RecoverReport, recover
from ssp_core.bag.states import object_states
from ssp_core.bag.writer import BagWriter

__all__ = [
    "BagMessage",
    "BagReader",
    "BagWriter",
    "RecoverReport",
    "TopicInfo",
    "object_states",
    "recover",
]
