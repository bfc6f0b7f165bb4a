"""Road users over several sentences, fields and tables (LABELLING.md).

``o=`` objects, ``p=`` position, ``m=`` motion; what isn't named must stay empty, and ``o=-`` is
the answer that nobody is there. Conflict and the plan aren't looked at.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from extract_tables import holds, score

LISTS = [
    ("Two objects need attention. First, a coach on the left. Second, a scooter behind the coach.",
     "o=bus,motorcycle p=left"),
    ("Objects: none. A taxi left a while ago.", "o=-"),
    ("| object | where | relevant |\n| van | ahead | yes |\n| jogger | on the left | no |",
     "o=car p=front"),
    ("Critical: a van ahead; truck behind (ignore).", "o=car p=front"),
    ("What is on the left? A moped. We keep our speed.", "o=motorcycle p=left"),
    ("Class: cyclist\nPos: rear left\nHow it moves: overtaking",
     "o=cyclist p=rear_left m=same_direction"),
]  # fmt: skip

REFERENCE = [
    ("A motorcycle is behind us. Wait until the bike has passed.", "o=motorcycle p=rear"),
    ("A man is ahead of us. A woman is on the left. She stands still. Slow down for her.",
     "o=pedestrian p=left m=stationary"),
    ("A bus is cutting in from the right; its rear is at our front right.",
     "o=bus p=front_right m=cutting_in_from_right"),
    ("The taxi is at our front left. Steer right behind the taxi's rear.", "o=car p=front_left"),
    ("The scooter ahead keeps its distance and the lane behind is empty.", "o=motorcycle p=front"),
    ("A girl ahead is waiting where her friends stand.",
     "o=pedestrian p=front m=stationary"),
    ("Ahead of us I notice a vehicle: an old camper van.", "o=car p=front"),
]  # fmt: skip

PARTS = [
    ("The camera sits behind the windscreen of a car.", ""),
    ("There is a bike stand on the right.", ""),
    ("A van stands in front of a car dealership.", "o=car m=stationary"),
    ("An SUV is coming out of a parking bay ahead.", "o=car p=front m=same_direction"),
    ("A taxi ahead waits in the pocket of the opposite direction.",
     "o=car p=front m=stationary"),
    ("Pedestrians may step out.", ""),
]  # fmt: skip

SIDES = [
    ("Van cutting in from R.", "o=car m=cutting_in_from_right"),
    ("Jogger, left → right, ahead.", "o=pedestrian p=front m=crossing_from_left"),
    ("A jogger runs across the road to the left.", "o=pedestrian m=crossing_from_right"),
    ("A cyclist is on the cycle path to the right.", "o=cyclist p=right"),
    ("The boy has reached the right pavement.", "o=pedestrian p=right"),
    ("A coach travels in the left lane beside us.", "o=bus p=left m=same_direction"),
    ("Van left, parallel.", "o=car p=left m=same_direction"),
    ("On the crosswalk ahead of us, a lady is walking.", "o=pedestrian p=front"),
    ("Two children wait on the VUT's right.", "o=pedestrian p=right m=stationary"),
    ("A truck ahead is going at maybe 40 km/h.", "o=truck p=front m=same_direction"),
    ("A pickup turns into our lane from the left.", "o=car m=cutting_in_from_left"),
    ("A cab squeezes into ours from the right.", "o=car m=cutting_in_from_right"),
    ("The old man ahead has frozen.", "o=pedestrian p=front m=stationary"),
    ("A lady makes her way over the zebra crossing from the left.",
     "o=pedestrian m=crossing_from_left"),
    ("From the left, a pedestrian is stepping onto the zebra crossing.",
     "o=pedestrian m=crossing_from_left"),
    ("A pupil has just stepped onto the left pavement.", "o=pedestrian p=left"),
    ("Two cyclists ride side by side in front of us.", "o=cyclist p=front m=same_direction"),
    ("I don't see any road users.", "o=-"),
    ("A car crosses our path from the left.", "o=car m=crossing_from_left"),
    ("A taxi crosses the line into our lane from the left.", "o=car m=cutting_in_from_left"),
    ("A scooter cuts across our lane from left to right.", "o=motorcycle m=crossing_from_left"),
    ("No cyclists or other road users are visible.", "o=-"),
    ("Someone may walk out from behind the bus ahead.", "o=bus p=front"),
    ("A van is heading straight for us.", "o=car m=oncoming"),
    ("A car at the rear left is catching up.", "o=car p=rear_left m=same_direction"),
    ("A moped ahead of us is lying on the road.", "o=motorcycle p=front m=stationary"),
]  # fmt: skip

CASES = LISTS + REFERENCE + PARTS + SIDES


def test_the_rules_read_discourse() -> None:
    assert holds(score(CASES, ("objects", "position", "motion")), 0.95, 0.81)
