"""The quality of service with which a recorded topic is published again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ssp_core import names
from ssp_core.bag.metadata import parse_offered_qos

# Room for a subscriber that stalls for a moment. What a subscriber has acknowledged is forgotten,
# so that it costs nothing while all keep up.
VOLATILE_DEPTH = 500
# A bag's own word for it must not make this process keep any number of messages for good.
MOST_LATCHED = 1000
_LATCHED_DEPTH = 20  # as in ssp_core.ros
_LATCHED_NAMES = frozenset(
    names.absolute(name)
    for name in (
        names.SESSION_STATE,
        names.TRIGGER_EVENT,
        names.PHASE_EVENT,
        names.SAFETY_EVENT,
        names.FAULT_EVENT,
        names.CAMERA_MOUNT,
        names.TF_STATIC,
    )
)
# As words, and as the numbers that rosbag2 wrote before them.
_BEST_EFFORT = ("best_effort", 2)
_TRANSIENT_LOCAL = ("transient_local", 1)


@dataclass(frozen=True, slots=True)
class Offer:
    """What the publisher offers. Deadline, lifespan and liveliness are left at their defaults: a
    replay that is paused or slowed down couldn't keep them.

    Args:
        reliable: lost packets are sent again.
        latched: transient local, the last ``depth`` messages are kept for those who come later.
        depth: messages.
    """

    reliable: bool = True
    latched: bool = False
    depth: int = VOLATILE_DEPTH


def _whole(value: Any) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and value > 0 else 1


def offer_of(topic: str, offered_qos: str) -> Offer:
    """The offer for a topic.

    Of several recorded publishers the strongest offer is taken, which every subscriber that heard
    one of them takes too, with room for what each of them kept.

    Args:
        topic: absolute name; decides where the bag says nothing of use.
        offered_qos: YAML of the channel, or empty.
    """
    try:
        profiles = parse_offered_qos(offered_qos)
    except ValueError:
        profiles = []
    if not profiles:
        latched = topic in _LATCHED_NAMES
        return Offer(latched=latched, depth=_LATCHED_DEPTH if latched else VOLATILE_DEPTH)
    reliable = any(profile.get("reliability") not in _BEST_EFFORT for profile in profiles)
    latched = any(profile.get("durability") in _TRANSIENT_LOCAL for profile in profiles)
    if not latched:
        return Offer(reliable=reliable)
    # Each publisher kept its own: of /tf_static all of them are the whole.
    depth = min(sum(_whole(profile.get("depth")) for profile in profiles), MOST_LATCHED)
    return Offer(reliable=reliable, latched=True, depth=depth)
