"""Quality of service as a bag states it: the complete YAML that rosbag2 and rosbags need."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import yaml

from ssp_core.errors import InputError
from ssp_core.files import parse_value

# A topic of a hundred publishers has 50,000.
MAX_TEXT = 64 << 10
# As rosbag2 writes it: by name, or before Jazzy by rmw's number.
_LATCHED = ("transient_local", 1)
_KEEP_ALL = ("keep_all", 2)
# A publisher doesn't tell others its history; what a graph says of it then is no depth.
_UNTOLD = ("unknown", 3, "system_default", 0)
# rmw's infinite duration, as rosbag2 writes it.
_INFINITE = {"sec": 9223372036, "nsec": 854775807}


def offered_qos(depth: int, *, transient_local: bool = False) -> str:
    """YAML of one reliable KEEP_LAST publisher, for BagWriter.add_topic.

    Args:
        depth: the publisher's history, messages.
        transient_local: the publisher keeps its last messages for those that join later.
    """
    profile = {
        "history": "keep_last",
        "depth": depth,
        "reliability": "reliable",
        "durability": "transient_local" if transient_local else "volatile",
        "deadline": dict(_INFINITE),
        "lifespan": dict(_INFINITE),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_INFINITE),
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([profile], sort_keys=False)


@lru_cache(maxsize=1024)
def parse_offered_qos(text: str) -> list[dict[str, Any]]:
    """The profiles in the YAML of a channel; an empty text has none.

    The result is shared by all callers with the same text, since thousands of topics have the
    same few profiles: it must not be changed.

    Raises:
        ValueError: the text is no YAML list of mappings.
    """
    if not text:
        return []
    if len(text) > MAX_TEXT:
        raise ValueError(f"offered_qos_profiles has {len(text)} characters, at most {MAX_TEXT}")
    try:
        profiles = parse_value(text, "offered_qos_profiles")
    except InputError as error:
        raise ValueError(str(error)) from error
    if not isinstance(profiles, list) or not all(isinstance(item, dict) for item in profiles):
        raise ValueError("offered_qos_profiles is no list of mappings")
    return profiles


def is_latched(offered_qos: str) -> bool:
    """Whether a publisher keeps its messages for those that join later.

    Args:
        offered_qos: YAML of a topic's publishers; what is no such YAML says nothing.
    """
    try:
        profiles = parse_offered_qos(offered_qos)
    except ValueError:
        return False
    return any(profile.get("durability") in _LATCHED for profile in profiles)


def stated_depth(offered_qos: str, most: int) -> int | None:
    """How many messages a topic's publishers offer together to one who joins late.

    Args:
        offered_qos: YAML of a topic's publishers.
        most: no claim beyond this is believed; it is what KEEP_ALL has.

    Returns:
        None: at least one of them doesn't say how many, or there is none.

    Raises:
        ValueError: the text is no YAML list of mappings.
    """
    depth = 0
    for profile in parse_offered_qos(offered_qos):
        claimed, history = profile.get("depth"), profile.get("history")
        if history in _KEEP_ALL:
            depth += most
        elif isinstance(claimed, int) and claimed > 0 and history not in _UNTOLD:
            depth += claimed
        else:
            return None
    return min(depth, most) or None
