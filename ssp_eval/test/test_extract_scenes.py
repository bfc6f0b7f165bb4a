"""Road users, where they are and what they do, in their usual wordings (LABELLING.md).

``o=`` objects, ``p=`` position, ``m=`` motion; what isn't named must stay empty, and ``o=-`` is
the answer that nobody is there. Conflict and the plan aren't looked at.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from extract_tables import holds, score

NOUNS = [
    ("A woman on a racing bike is ahead.", "o=cyclist p=front"),
    ("A lad riding a moped is ahead on the left.", "o=motorcycle p=front_left"),
    ("A man pushing his bicycle is on the right.", "o=pedestrian p=right"),
    ("A people carrier is ahead.", "o=car p=front"),
    ("The coupé ahead is braking.", "o=car p=front m=same_direction"),
    ("A tow truck driver is ahead.", "o=truck p=front"),
    ("The vehicle on the right, a cement mixer, is stopped.", "o=truck p=right m=stationary"),
    ("A bus is ahead. It's a school bus.", "o=bus p=front"),
    ("A cyclist is ahead. The rider is waiting now.", "o=cyclist p=front m=stationary"),
    ("Two cars are parked on the right. The car ahead is braking.",
     "o=car p=front m=same_direction"),
    ("The red car is on the left. Slow down for the white car ahead.", "o=car p=front"),
]  # fmt: skip

PRESENCE = [
    ("Critical road user: the cyclist; skip the car.", "o=cyclist"),
    ("The lorry on the left is gone.", ""),
    ("Vehicles ahead: none. Pedestrians: none.", ""),
    ("Pedestrian: none. Cyclists: none. Cars: none. The street is deserted.", "o=-"),
    ("A car could come over the crest.", ""),
    ("Somebody may be hidden by the parked van on the right.", "o=car p=right m=stationary"),
    ("A child runs out from behind a parked lorry.", "o=truck,pedestrian"),
    ("Slow down for the jogger to the left of the parked pickup.", "o=pedestrian"),
    ("The post was mistaken for a person.", ""),
    ("No one is here, but a van is parked on the left.", ""),
    ("Objects:\n- Van: at the left kerb, standing\n- Tram: not relevant",
     "o=car p=left m=stationary"),
    ("Stop the car.", ""),
    ("The picture is taken from a car.", ""),
]  # fmt: skip

PLACES = [
    ("A cyclist is in front of the ego vehicle.", "o=cyclist p=front"),
    ("A taxi is stopped in front of the car.", "o=car m=stationary"),
    ("A boy is crossing from the right in front of the car.",
     "o=pedestrian p=front m=crossing_from_right"),
    ("A van is in the lane to our left.", "o=car p=left"),
    ("In the lane to our right, a bus is travelling alongside us.",
     "o=bus p=right m=same_direction"),
    ("A van stands close to the right edge of the lane.", "o=car p=right m=stationary"),
    ("A truck is on the right behind us.", "o=truck p=rear_right"),
    ("A car is on its left.", "o=car"),
    ("A bus is ahead; its rear is damaged.", "o=bus p=front"),
    ("Child. In front.", "o=pedestrian p=front"),
    ("Scooter (left, parallel).", "o=motorcycle p=left m=same_direction"),
    ("SUV, right lane, stationary.", "o=car p=right m=stationary"),
    ("The car on the left may pull out in front of us.", "o=car p=left"),
    ("The lorry crossed before us and waits now.", "o=truck m=stationary"),
    ("There is a shop on the right and, ahead on the left, a man waits.",
     "o=pedestrian p=front_left m=stationary"),
    ("The van is on the left of the parked bus.", "o=car"),
    ("Watch the cyclist ahead, whose way on the right is blocked.", "o=cyclist p=front"),
]  # fmt: skip

MOTIONS = [
    ("Front: pedestrian walking left -> right", "o=pedestrian p=front m=crossing_from_left"),
    ("Ped xing R->L ahead.", "o=pedestrian p=front m=crossing_from_right"),
    ("A jogger came from the right. She is crossing.", "o=pedestrian m=crossing_from_right"),
    ("A girl walks from the left side to the right across the road.",
     "o=pedestrian m=crossing_from_left"),
    ("A van comes from the left lane and is merging into our lane.",
     "o=car m=cutting_in_from_left"),
    ("A lorry is ahead. Its trailer drifts into our lane from the right.",
     "o=truck p=front m=cutting_in_from_right"),
    ("The SUV, however, is turning and pulling into our lane from the right.",
     "o=car m=cutting_in_from_right"),
    ("A car crosses the lane marking from the left.", "o=car m=cutting_in_from_left"),
    ("A taxi ahead of us on the left has started drifting into our lane.",
     "o=car p=front_left m=cutting_in_from_left"),
    ("Coming towards us is a motorcycle.", "o=motorcycle m=oncoming"),
    ("A cyclist is heading straight at us.", "o=cyclist m=oncoming"),
    ("A car in the opposite lane is approaching.", "o=car m=oncoming"),
    ("An oncoming van ahead is moving slowly.", "o=car p=front m=oncoming"),
    ("A lorry drives at our speed ahead of us.", "o=truck p=front m=same_direction"),
    ("An overtaking motorbike is on our left.", "o=motorcycle p=left m=same_direction"),
    ("A bus rides in our lane ahead.", "o=bus p=front m=same_direction"),
    ("The hatchback ahead is pulling away, and the gap keeps growing.",
     "o=car p=front m=receding"),
    ("A pedestrian leaves our lane.", "o=pedestrian"),
    ("A bus is still crossing from the right.", "o=bus m=crossing_from_right"),
    ("The taxi ahead has not moved.", "o=car p=front m=stationary"),
    ("The taxi on the right is not moving into our lane.", "o=car p=right"),
    ("A car ahead is waiting for us.", "o=car p=front m=stationary"),
    ("Avoid the sedan swerving into our lane from the left.", "o=car m=cutting_in_from_left"),
    ("Critical object 1: scooter\nPosition: front right\nMotion: crossing from the right",
     "o=motorcycle p=front_right m=crossing_from_right"),
]  # fmt: skip

CASES = NOUNS + PRESENCE + PLACES + MOTIONS


def test_the_rules_read_scenes() -> None:
    assert holds(score(CASES, ("objects", "position", "motion")), 0.97, 0.83)


def test_the_table_has_no_text_twice() -> None:
    assert len({text for text, _ in CASES}) == len(CASES)
