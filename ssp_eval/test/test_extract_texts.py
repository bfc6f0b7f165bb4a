"""Short texts with all six slots as a careful reader takes them (LABELLING.md).

An expectation names every slot that the text fills, ``slot=value`` with o objects, p position,
m motion, c conflict, lon and lat actions; a slot that isn't named must stay empty. ``o=-`` is the
answer that nobody is there.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from ssp_eval.data.records import SLOT_NAMES

sys.path.insert(0, str(Path(__file__).parent))

from extract_tables import holds, score

OBJECTS = [
    ("A van is ahead.", "o=car p=front"),
    ("A pickup truck is ahead.", "o=car p=front"),
    ("A tractor-trailer is ahead.", "o=truck p=front"),
    ("A garbage truck is stopped ahead.", "o=truck p=front m=stationary"),
    ("A school bus is ahead on the right.", "o=bus p=front_right"),
    ("A motorbike is ahead.", "o=motorcycle p=front"),
    ("A bicyclist is on the left.", "o=cyclist p=left"),
    ("A wheelchair user is on the right.", "o=pedestrian p=right"),
    ("A child is ahead on the left.", "o=pedestrian p=front_left"),
    ("A person on a bike is ahead.", "o=cyclist p=front"),
    ("Traffic is heavy.", ""),
    ("A tram is ahead.", ""),
    ("A dog is on the road ahead.", ""),
    ("There is a bus stop on the right.", ""),
    ("A bike lane runs along the right.", ""),
    ("There is a pedestrian crossing ahead.", ""),
    ("No pedestrians are visible.", ""),
    ("There are no cars or trucks ahead.", ""),
    ("There are no road users.", "o=-"),
    ("Nobody is ahead.", "o=-"),
    ("No one is crossing.", ""),
    ("There are no vehicles, pedestrians or cyclists.", "o=-"),
    ("There are no road users that matter to me. There is no risk of a collision.",
     "o=- c=no_conflict"),
    ("Critical objects: none.", "o=-"),
    ("The picture is black; nothing can be seen.", ""),
    ("If a pedestrian appears, brake.", ""),
    ("A pedestrian might be hidden somewhere.", ""),
    ("There may be a pedestrian on the right.", ""),
    ("Watch for pedestrians.", ""),
    ("Watch the pedestrian on the right.", "o=pedestrian p=right"),
    ("Be alert for any cyclists.", ""),
    ("Cars are parked on the right.", ""),
    ("Slow down because a parked van blocks our lane ahead.",
     "o=car p=front m=stationary lon=decelerate"),
    ("A parked truck on the right hides a pedestrian.", "o=truck,pedestrian p=right m=stationary"),
    ("There are cars in the background. A pedestrian is crossing from the left.",
     "o=pedestrian m=crossing_from_left"),
    ("The truck on the left is irrelevant. The car ahead is braking.",
     "o=car p=front m=same_direction"),
    ("Critical objects: a cyclist on the right. A bus is visible too.", "o=cyclist p=right"),
    ("A car and a pedestrian are ahead.", "o=car,pedestrian p=front"),
    ("Previously there was a truck ahead.", ""),
    ("Is there a pedestrian ahead?", ""),
    ("Question: is a car ahead? Answer: a bus is ahead.", "o=bus p=front"),
    ('The prompt says: "Watch the pedestrian. Stop for the car." I keep my speed.', "lon=maintain"),
    ("Our car is in the middle lane.", ""),
    ("The ego vehicle follows the lead truck.", "o=truck p=front"),
    ("Notable Objects: car at (4.36,9.56), moving to (4.36,9.57)", "o=car"),
]  # fmt: skip

POSITIONS = [
    ("Keep distance to the lead vehicle.", "o=car p=front"),
    ("A car is directly ahead of us.", "o=car p=front"),
    ("A car is in front of the bus.", "o=car,bus"),
    ("A car is behind us.", "o=car p=rear"),
    ("A car is behind us on the left.", "o=car p=rear_left"),
    ("A car is alongside on the left.", "o=car p=left"),
    ("A pedestrian stands at the left kerb.", "o=pedestrian p=left m=stationary"),
    ("A cyclist is to our right.", "o=cyclist p=right"),
    ("A cyclist is on the right-hand side of the road.", "o=cyclist p=right"),
    ("A car is ahead in the left lane.", "o=car p=front_left"),
    ("Ahead, a car is braking.", "o=car p=front m=same_direction"),
    ("On the right, a pedestrian is waiting.", "o=pedestrian p=right m=stationary"),
    ("The car comes from the right.", "o=car"),
    ("The vehicle to the right of the cyclist is stopped.", "o=car,cyclist m=stationary"),
    ("A car is at (3.2, -1.5).", "o=car"),
    ("Frame 1: the car is on the left. Frame 2: the car is ahead.", "o=car p=front"),
    ("The car is on the left in frame 1 and ahead of us in frame 2.", "o=car p=front"),
    ("In the first image a cyclist is on the right, in the last image it is ahead.",
     "o=cyclist p=front"),
    ("The road bends ahead.", ""),
    ("A truck is on the left and a pedestrian is crossing from the right.",
     "o=pedestrian m=crossing_from_right"),
    ("A bus is ahead on the left. I slow down for the cyclist on the right.",
     "o=cyclist p=right lon=decelerate"),
    ("The car on the left could hit us. The car on the right is harmless.",
     "o=car p=left c=potential"),
    ("The slower right-lane vehicle is ahead.", "o=car p=front_right"),
    ("We stay behind the truck.", "o=truck"),
    ("A motorcycle is at the rear left.", "o=motorcycle p=rear_left"),
    ("Right now a car is ahead.", "o=car p=front"),
    ("The car has left our lane.", "o=car c=resolved"),
]  # fmt: skip

MOTIONS = [
    ("A pedestrian is crossing from the left.", "o=pedestrian m=crossing_from_left"),
    ("A pedestrian is crossing from right to left.", "o=pedestrian m=crossing_from_right"),
    ("A pedestrian crosses the road from our left.", "o=pedestrian m=crossing_from_left"),
    ("From the right, a pedestrian is crossing.", "o=pedestrian m=crossing_from_right"),
    ("A pedestrian is crossing.", "o=pedestrian"),
    ("A pedestrian on the right is crossing the road.", "o=pedestrian p=right"),
    ("Yield to the pedestrian crossing from the left.",
     "o=pedestrian m=crossing_from_left lon=decelerate"),
    ("A pedestrian walks across the street from the right.",
     "o=pedestrian m=crossing_from_right"),
    ("A cyclist is about to cross from the right.", "o=cyclist"),
    ("A pedestrian is waiting to cross.", "o=pedestrian m=stationary"),
    ("The pedestrian wants to cross from the left.", "o=pedestrian"),
    ("The pedestrian will cross from the left.", "o=pedestrian"),
    ("The pedestrian starts to cross from the left.", "o=pedestrian m=crossing_from_left"),
    ("The pedestrian is not crossing from the left.", "o=pedestrian"),
    ("A car is cutting in from the right.", "o=car m=cutting_in_from_right"),
    ("A car is merging into our lane from the left.", "o=car m=cutting_in_from_left"),
    ("A truck drifts into our lane from the right.", "o=truck m=cutting_in_from_right"),
    ("A car in the left lane is pulling into our lane.",
     "o=car p=left m=cutting_in_from_left"),
    ("A car is cutting in.", "o=car"),
    ("The car is signaling left.", "o=car"),
    ("The car is leaving our lane.", "o=car m=cutting_out"),
    ("The lead vehicle is braking.", "o=car p=front m=same_direction"),
    ("The car ahead is slowing down.", "o=car p=front m=same_direction"),
    ("A car is driving alongside on the left.", "o=car p=left m=same_direction"),
    ("A car is overtaking us.", "o=car m=same_direction"),
    ("A truck is tailgating us.", "o=truck m=same_direction"),
    ("A car approaches from behind.", "o=car p=rear"),
    ("The lead car is pulling away from us.", "o=car p=front m=receding"),
    ("An oncoming truck is ahead.", "o=truck p=front m=oncoming"),
    ("A car is coming towards us.", "o=car m=oncoming"),
    ("The bus ahead has stopped.", "o=bus p=front m=stationary"),
    ("The car ahead was braking.", ""),
    ("A car is stopped ahead and a cyclist passes us.", "o=car,cyclist p=front m=stationary"),
    ("The pedestrian has crossed the road.", "o=pedestrian c=resolved"),
    ("The truck could swerve into our lane from the left.", "o=truck c=potential"),
    ("A car travels in the same direction.", "o=car m=same_direction"),
    ("If the car were to cut in from the left, we would brake.", ""),
    ("The pedestrian steps into the road from the right.", "o=pedestrian m=crossing_from_right"),
    ("The car ahead is braking while turning left.", "o=car p=front m=same_direction"),
]  # fmt: skip

CONFLICTS = [
    ("There is a risk of collision with the car ahead.", "o=car p=front c=potential"),
    ("The cyclist may swerve.", "o=cyclist c=potential"),
    ("The car poses a potential hazard.", "o=car c=potential"),
    ("We are on a collision course with the truck.", "o=truck c=active"),
    ("A collision with the pedestrian is imminent.", "o=pedestrian c=active"),
    ("A collision is imminent unless we brake.", "c=active"),
    ("The pedestrian is now in our path and we must brake.",
     "o=pedestrian c=active lon=decelerate"),
    ("The pedestrian is no longer a risk.", "o=pedestrian c=resolved"),
    ("The car has passed.", "o=car c=resolved"),
    ("The cyclist has cleared our lane.", "o=cyclist c=resolved"),
    ("The pedestrian poses no risk.", "o=pedestrian c=no_conflict"),
    ("The car does not affect us.", "o=car c=no_conflict"),
    ("The bus is harmless.", "o=bus c=no_conflict"),
    ("There is no conflict.", "c=no_conflict"),
    ("A pedestrian is crossing ahead, so yield.", "o=pedestrian p=front lon=decelerate"),
    ("If nothing changes there is a risk of collision.", ""),
    ("Once the pedestrian has passed, I accelerate.", ""),
    ("Brake to avoid a collision.", "lon=decelerate"),
    ("The car was a risk earlier.", ""),
    ("Is there a risk of collision?", ""),
    ("A car is on the left. There is a risk of a collision with the car.",
     "o=car p=left c=potential"),
    ("The pedestrian does not pose a threat.", "o=pedestrian c=no_conflict"),
]  # fmt: skip

LONGITUDINAL = [
    ("I slow down.", "lon=decelerate"),
    ("Ease off the accelerator.", "lon=decelerate"),
    ("We should brake.", "lon=decelerate"),
    ("The ego vehicle yields.", "lon=decelerate"),
    ("Reduce speed.", "lon=decelerate"),
    ("Come to a stop.", "lon=stop"),
    ("Hold position.", "lon=stop"),
    ("Slow down and stop.", "lon=stop"),
    ("Slow down and then stop behind the bus.", "o=bus lon=stop"),
    ("Slow down and be ready to stop.", "lon=decelerate"),
    ("Prepare to brake.", ""),
    ("Be ready to stop.", ""),
    ("Keep distance.", ""),
    ("Proceed with caution.", ""),
    ("Continue.", ""),
    ("Adapt speed for the curve.", ""),
    ("We should not accelerate.", ""),
    ("Do not brake.", ""),
    ("There is no need to brake.", ""),
    ("Braking is not necessary.", ""),
    ("Braking would be dangerous.", ""),
    ("Either brake or accelerate.", ""),
    ("Brake or change lanes to the left.", ""),
    ("Brake if necessary.", ""),
    ("If the car cuts in, brake.", ""),
    ("Accelerate once the light turns green.", ""),
    ("Slow down and stop if necessary.", "lon=decelerate"),
    ("I could brake.", ""),
    ("I will brake.", "lon=decelerate"),
    ("I am going to stop.", "lon=stop"),
    ("I braked.", ""),
    ("Instead of braking, I keep my speed.", "lon=maintain"),
    ("Keep a constant speed.", "lon=maintain"),
    ("Cruise at the current speed.", "lon=maintain"),
    ("Maintain a safe speed.", ""),
    ("Maintain a safe distance.", ""),
    ("Continue at the same speed.", "lon=maintain"),
    ("MOVE FORWARD WITH A CONSTANT SPEED", "lon=maintain"),
    ("Speed up.", "lon=accelerate"),
    ("Resume speed.", "lon=accelerate"),
    ("Set off.", "lon=accelerate"),
    ("I keep my speed. A pedestrian steps out. I brake.", "o=pedestrian lon=decelerate"),
    ("I keep my speed, but now I slow down.", "lon=decelerate"),
    ("Brake now, then accelerate.", "lon=decelerate"),
    ("Slow down. Then accelerate.", "lon=decelerate"),
    ("I accelerate. The light is red. Actually, I stop.", "lon=stop"),
    ("Reasoning: we could stop. Final plan: slow down.", "lon=decelerate"),
    ("Option A: brake. Option B: accelerate.", ""),
    ("The stop sign is ahead.", ""),
    ("The brake lights of the car ahead are on.", "o=car p=front"),
    ("The car ahead stops.", "o=car p=front m=stationary"),
    ("The car ahead is braking, so I brake.", "o=car p=front m=same_direction lon=decelerate"),
    ("The car ahead is braking, slow down.", "o=car p=front m=same_direction lon=decelerate"),
    ("Wait for the car to stop.", "o=car"),
    ("Should we brake?", ""),
    ("Gradual deceleration", "lon=decelerate"),
    ("Keep the speed low.", ""),
]  # fmt: skip

LATERAL = [
    ("Stay in our lane.", "lat=straight"),
    ("Keep lane.", "lat=straight"),
    ("Remain in the current lane.", "lat=straight"),
    ("Go straight through the intersection.", "lat=straight"),
    ("No steering.", "lat=straight"),
    ("Brake in our lane.", "lon=decelerate lat=straight"),
    ("The ego vehicle brakes in its lane.", "lon=decelerate lat=straight"),
    ("Maintain speed and lane.", "lon=maintain lat=straight"),
    ("Keep my speed and stay in my lane.", "lon=maintain lat=straight"),
    ("Nudge left.", "lat=left"),
    ("Steer slightly to the right.", "lat=right"),
    ("Change lanes to the left.", "lat=left"),
    ("Change to the right lane.", "lat=right"),
    ("Make a left lane change.", "lat=left"),
    ("Turn right at the intersection.", "lat=right"),
    ("Merge into the left lane.", "lat=left"),
    ("Swerve to the left.", "lat=left"),
    ("Change lanes.", ""),
    ("No overtaking.", ""),
    ("Do not change lanes to the left.", ""),
    ("Avoid steering to the right.", ""),
    ("Without changing lanes to the left, slow down.", "lon=decelerate"),
    ("Follow the curve to the left.", ""),
    ("Adapt speed for the right curve because the road bends ahead.", ""),
    ("Slow down, then turn left.", "lon=decelerate lat=left"),
    ("Stay in our lane, then change to the left lane.", "lat=straight"),
    ("Stay in our lane until the car has passed, then change to the left lane.",
     "o=car lat=straight"),
    ("Prepare to turn left.", ""),
    ("Slow down slightly and keep left within the lane.", "lon=decelerate lat=left"),
    ("The car ahead is turning left.", "o=car p=front"),
    ("The right-turn-only lane ends.", ""),
    ("I change to the left lane. Wait, a car is alongside on the left. I brake instead.",
     "o=car p=left lon=decelerate"),
    ("Correct action: [['STRAIGHT','DECELERATE'],['STRAIGHT','MAINTAIN']]",
     "lon=decelerate lat=straight"),
    ("Correct action: [['TURN_LEFT','MAINTAIN'],['STRAIGHT','STOP']]", "lon=maintain lat=left"),
    ("<think>turn left</think>", "lat=left"),
    ("Steer away from the right curb.", ""),
    ("Nudge around the car on the right.", "o=car p=right"),
]  # fmt: skip

WHOLE = [
    ("Nudge left to increase clearance from the parked car on the right shoulder.",
     "o=car p=right m=stationary lat=left"),
    ("A pedestrian is ahead on the right and is crossing from the right. "
     "A collision is imminent, so I slow down and stay in my lane.",
     "o=pedestrian p=front_right m=crossing_from_right c=active lon=decelerate lat=straight"),
    ("Keep distance to the lead vehicle because it is directly ahead in the same lane.",
     "o=car p=front"),
    ("Accelerate to proceed through the intersection since the traffic light turns green",
     "lon=accelerate"),
    ("Change lanes to the left to position in the through lane and maintain clearance from the "
     "right curb/parked vehicles while proceeding through the intersection.",
     "o=car m=stationary lat=left"),
    ("Change to the left lane to pass the slower lead vehicle while gently slowing for the "
     "upcoming crosswalk.", "o=car p=front lon=decelerate lat=left"),
    ("Yield due to a pedestrian crossing from the right ahead.",
     "o=pedestrian p=front m=crossing_from_right lon=decelerate"),
    ('{"objects": ["car", "pedestrian"], "position": "front_right", '
     '"motion": "crossing_from_right", "conflict": "potential", "lon_action": "decelerate", '
     '"lat_action": "straight"}',
     "o=car,pedestrian p=front_right m=crossing_from_right c=potential lon=decelerate "
     "lat=straight"),
    ('{"objects": [], "conflict": "none", "lon_action": "maintain", "lat_action": "left"}',
     "o=- c=no_conflict lon=maintain lat=left"),
    ("## Scene\nA two-lane road.\n## Critical objects\n- **Cyclist** on the right, moving in the "
     "same direction.\n## Plan\n- Slow down\n- Keep lane",
     "o=cyclist p=right m=same_direction lon=decelerate lat=straight"),
    ("Position: front left\nMotion: stationary\nConflict: resolved",
     "p=front_left m=stationary c=resolved"),
    ("A car ahead is braking and a pedestrian is crossing from the left, so I stop for the "
     "pedestrian.", "o=car,pedestrian m=crossing_from_left lon=stop"),
    ("A pedestrian\nis crossing from the left,\nso I brake.",
     "o=pedestrian m=crossing_from_left lon=decelerate"),
    ("I don’t brake. The bus isn’t crossing. I’ll keep my speed.", "o=bus lon=maintain"),
    (
        "The scene shows a two-lane road. There are several parked cars on the right side. A "
        "pedestrian in a red jacket is walking from the right sidewalk into the road, about 15 "
        "meters ahead. The ego vehicle should decelerate and be prepared to stop, while "
        "maintaining its current lane.",
        "o=pedestrian p=front m=crossing_from_right lon=decelerate lat=straight",
    ),
    (
        "A white sedan in the adjacent right lane is gradually moving into the ego lane. There is "
        "a potential for collision if both vehicles continue. The ego vehicle should slow down.",
        "o=car p=right m=cutting_in_from_right lon=decelerate",
    ),
    (
        "Critical object: a silver SUV located in front-left, moving in the same direction. "
        "Potential conflict: none. Plan: maintain speed, keep lane.",
        "o=car p=front_left m=same_direction c=no_conflict lon=maintain lat=straight",
    ),
    (
        "I considered changing lanes to the left, but a bus is alongside on the left, so I brake "
        "and stay in my lane.",
        "o=bus p=left lon=decelerate lat=straight",
    ),
    (
        "There's a jogger on the left sidewalk, but she does not affect our path. Keep going "
        "straight at the current speed.",
        "o=pedestrian p=left c=no_conflict lon=maintain lat=straight",
    ),
    (
        "The closest road user is a cyclist at the right edge of the road. It's moving in the same "
        "direction as us. There's a potential conflict if it moves left. The plan: ease off the "
        "accelerator and give it room by shifting left.",
        "o=cyclist p=right m=same_direction c=potential lon=decelerate lat=left",
    ),
    (
        "Since the cyclist ahead on the right might swerve, I nudge left and reduce speed.",
        "o=cyclist p=front_right c=potential lon=decelerate lat=left",
    ),
    (
        "A woman with a stroller is crossing in front of us from the right; we must stop now.",
        "o=pedestrian p=front m=crossing_from_right lon=stop",
    ),
    (
        "Wait for the pedestrian to cross, then accelerate.",
        "o=pedestrian",
    ),
    (
        "The car is making a left turn, so I expect the curvature to be negative.",
        "",
    ),
    (
        "Critical objects:\n1. A cyclist on the right.\n2. A bus.\nA truck is visible as well.",
        "o=bus,cyclist p=right",
    ),
    ("Vehicle A is ahead in our lane; vehicle B is in the left lane.", "o=car p=front"),
    (
        "Turn left at the intersection after yielding to the truck.",
        "o=truck lon=decelerate lat=left",
    ),
    (
        "Critical objects:\n• a cyclist on the right.\n• a bus.\n\nPlan: keep lane. A truck is "
        "there.",
        "o=bus,cyclist p=right lat=straight",
    ),
    (
        "The car is making a left turn, so I expect a curve since it's turning left. The speed is "
        "decreasing, which makes sense as the car adjusts to the turn.",
        "",
    ),
    (
        "Pay attention to the bicycle in the center. This road user is important because bicycles "
        "are not designed to handle the same level of traffic as cars and motorcycles.",
        "o=cyclist",
    ),
    ("", ""),
    ("   \n", ""),
]  # fmt: skip

# A manoeuvre of ours that somebody blocks is none of his, and none that we make.
BLOCKED = [
    ("Keep lane because a car is on the left, blocking an immediate merge to the left.",
     "o=car p=left lat=straight"),
    ("Keep speed since a car alongside on the left is blocking an immediate merge to the left.",
     "o=car p=left lon=maintain"),
    ("Maintain speed; the truck on our left prevents us from changing lanes to the left.",
     "o=truck p=left lon=maintain"),
    ("The truck prevents us from changing lanes to the left, so stay in our lane.",
     "o=truck lat=straight"),
    ("Since a white car on our left is blocking the immediate merge, decelerate and wait for a "
     "gap.", "o=car p=left lon=decelerate"),
    ("A car in the blind spot keeps us from merging left.", "o=car"),
    ("The car beside us stops us from moving over to the left.", "o=car"),
    ("A truck on the left obstructs our merge into the left lane.", "o=truck p=left"),
    ("Wait for a gap: a sedan in the left lane impedes merging to the left.", "o=car p=left"),
    ("Slow down, since the bus blocks us from pulling into the left lane.",
     "o=bus lon=decelerate"),
    ("A merge to the left is blocked by a car on the left.", "o=car p=left"),
    ("Lane change to the left blocked by a bus, so hold speed.", "o=bus lon=maintain"),
    ("Merging to the left is prevented by a truck on the left; keep the lane.",
     "o=truck p=left lat=straight"),
    ("A cyclist on the left does not leave room to merge left, so we keep our lane.",
     "o=cyclist p=left lat=straight"),
    # Who blocks may move besides, a lane or path that is blocked is no manoeuvre, and the plan
    # that follows from it is ours.
    ("The truck blocks the left lane and merges into our lane from the left.",
     "o=truck m=cutting_in_from_left"),
    ("The car blocking the left lane is merging into our lane from the left, so brake.",
     "o=car m=cutting_in_from_left lon=decelerate"),
    ("The bus blocks our path and is moving into our lane from the right.",
     "o=bus m=cutting_in_from_right"),
    ("A taxi from the left merges into our lane, blocking our change to the left.",
     "o=car m=cutting_in_from_left"),
    ("A car blocked by the bus merges into our lane from the right.",
     "o=car,bus m=cutting_in_from_right"),
    ("Keep lane: the car keeping us from changing lanes is now cutting in from the left.",
     "o=car m=cutting_in_from_left lat=straight"),
    ("A car is on the left and is merging from the left into our lane.",
     "o=car p=left m=cutting_in_from_left"),
    ("Merge left because the lane ahead is blocked.", "lat=left"),
    ("Our lane is blocked by a truck; merge left.", "o=truck lat=left"),
    ("Lane change to the left due to stopped vehicles blocking our lane ahead.",
     "o=car p=front m=stationary lat=left"),
]  # fmt: skip

TABLES = {
    "objects": OBJECTS, "positions": POSITIONS, "motions": MOTIONS, "conflicts": CONFLICTS,
    "longitudinal": LONGITUDINAL, "lateral": LATERAL, "whole": WHOLE, "blocked": BLOCKED,
}  # fmt: skip
# Precision and recall, a little under what was measured.
FLOORS = {
    "objects": (0.95, 0.87), "positions": (0.94, 0.72), "motions": (0.99, 0.84),
    "conflicts": (0.99, 0.88), "longitudinal": (0.99, 0.96), "lateral": (0.97, 0.96),
    "whole": (0.98, 0.91), "blocked": (0.99, 0.95),
}  # fmt: skip
CASES = [case for table in TABLES.values() for case in table]


@pytest.mark.parametrize("name", TABLES)
def test_the_rules_read_a_table(name: str) -> None:
    assert holds(score(TABLES[name], SLOT_NAMES), *FLOORS[name])


def test_the_table_has_no_text_twice() -> None:
    assert len({text for text, _ in CASES}) == len(CASES) >= 150
