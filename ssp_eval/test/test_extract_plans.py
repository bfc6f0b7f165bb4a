"""The ego's plan in its usual wordings (LABELLING.md): lon_action and lat_action, class by class.

``lon=value`` and ``lat=value``; what isn't named must stay empty. Other slots aren't looked at.
"""

from __future__ import annotations

import pytest

from ssp_eval.extract import extract

PACE = [
    ("Lower our speed a bit.", "lon=decelerate"),
    ("We drop the speed to 30.", "lon=decelerate"),
    ("Shed some speed.", "lon=decelerate"),
    ("I take my foot off the gas.", "lon=decelerate"),
    ("Lift off the throttle gently.", "lon=decelerate"),
    ("The speed should be reduced.", "lon=decelerate"),
    ("Let the speed fall.", "lon=decelerate"),
    ("We go down to 20 km/h.", "lon=decelerate"),
    ("Apply the brakes softly.", "lon=decelerate"),
    ("Bring the speed back up.", "lon=accelerate"),
    ("We return to the normal travel speed.", "lon=accelerate"),
    ("The VUT regains its former speed.", "lon=accelerate"),
    ("Resume 50 km/h.", "lon=accelerate"),
    ("Speed can be increased.", "lon=accelerate"),
    ("Hold our 40 km/h.", "lon=maintain"),
    ("Keep 12 m/s and our lane.", "lon=maintain lat=straight"),
    ("We roll on at an unchanged 30 km/h.", "lon=maintain"),
    ("Drive on with unaltered speed.", "lon=maintain"),
    ("Leave the speed as it is.", "lon=maintain"),
    ("Speed stays constant.", "lon=maintain"),
    ("The speed is held, the lane is kept.", "lon=maintain lat=straight"),
    ("Speed: hold. Steering: none.", "lon=maintain lat=straight"),
    ("Lane: keep\nSpeed: unchanged", "lon=maintain lat=straight"),
    ("Reduce to 30.", "lon=decelerate"),
    ("Command: hold 40, lane keep.", "lon=maintain lat=straight"),
    ("The ego makes its speed lower.", "lon=decelerate"),
    ("Let the car roll.", "lon=decelerate"),
    ("Keep driving at the same pace.", "lon=maintain"),
    ("We drive on at the same speed as before.", "lon=maintain"),
    ("Steer right, speed as is.", "lon=maintain lat=right"),
    ("Follow the truck, const. speed.", "lon=maintain"),
    ("A soft brake application is enough.", "lon=decelerate"),
    ("A light brake application will do.", "lon=decelerate"),
    ("Its speed is 12 m/s.", ""),
    ("We keep a low speed limit in mind.", ""),
    ("The speed of the van is constant.", ""),
    ("The speed limit drops to 30.", ""),
]

HALTS = [
    ("Brake firmly to a complete standstill.", "lon=stop"),
    ("We slow down smoothly to a full stop.", "lon=stop"),
    ("Bring the car gently to a halt.", "lon=stop"),
    ("Remain at rest.", "lon=stop"),
    ("The ego vehicle stays stationary for now.", "lon=stop"),
    ("Keep standing.", "lon=stop"),
    ("Full braking until standstill.", "lon=stop"),
    ("Brake with full force till a stop.", "lon=stop"),
    ("Brake hard, come to a halt before the line.", "lon=stop"),
    ("Wait here.", "lon=stop"),
    ("Stay put behind him.", ""),
    ("Brake as hard as possible.", "lon=decelerate"),
    ("Slow down to the stop sign.", "lon=decelerate"),
]

LATERAL = [
    ("Keep the wheel straight.", "lat=straight"),
    ("The steering stays straight.", "lat=straight"),
    ("No evasive steering.", "lat=straight"),
    ("Direction unchanged.", "lat=straight"),
    ("We stay behind the bus in our lane.", "lat=straight"),
    ("Stay in the centre of the lane.", "lat=straight"),
    ("Keep to the nearside lane.", "lat=straight"),
    ("We brake within our own lane.", "lon=decelerate lat=straight"),
    ("Emergency braking, straight on.", "lon=decelerate lat=straight"),
    ("Nudge R.", "lat=right"),
    ("Change left.", "lat=left"),
    ("Shift slightly left within the lane.", "lat=left"),
    ("Keep well to the right.", "lat=right"),
    ("Keep a little left.", "lat=left"),
    ("Direction is straight ahead.", "lat=straight"),
    ("Keep the direction straight. The lane stays the same.", "lat=straight"),
    ("Steering: leave straight", "lat=straight"),
    ("We set off again, straight ahead.", "lon=accelerate lat=straight"),
    ("A car is straight ahead.", ""),
    ("We shift to the right edge of the lane.", "lat=right"),
    ("No lane change.", ""),
    ("No steering to the left.", ""),
    ("A lane change to the left is not recommended.", ""),
]

INTENTIONS = [
    ("The ego vehicle intends to slow down.", "lon=decelerate"),
    ("The ego wants to turn left.", "lat=left"),
    ("We plan to keep our speed.", "lon=maintain"),
    ("The ego car is likely to stop.", "lon=stop"),
    ("The truck intends to slow down.", ""),
    ("I'd slow down here.", "lon=decelerate"),
    ("I'd therefore slow down.", "lon=decelerate"),
    ("I would rather keep the speed and move left.", "lon=maintain lat=left"),
    ("Brake? Yes. Change lanes? No.", "lon=decelerate"),
    ("If it rained I'd slow down.", ""),
    ("We prepare to stop.", ""),
    ("Intent: The car drives on at constant speed.", "lon=maintain"),
    ("The car should slow down.", "lon=decelerate"),
    ("The ego car slows down. It keeps its lane.", "lon=decelerate lat=straight"),
    ("The ego therefore slows by 2 m/s and stays in its lane.", "lon=decelerate lat=straight"),
]

NOT_CHOSEN = [
    ("Braking would be a bad idea.", ""),
    ("Slowing down isn't necessary.", ""),
    ("Speeding up is not allowed here.", ""),
    ("Stopping for someone who may be waiting is excessive.", ""),
    ("Swerving to the right, where the kerb is, would be wrong.", ""),
    ("Slowing down is required.", "lon=decelerate"),
    ("The reason for braking is gone.", ""),
    ("The deceleration for the exit starts later.", ""),
    ("One could honk and keep the speed.", ""),
    ("Either brake or keep the speed.", ""),
    ("Stop or slow down, depending on whether the light changes.", ""),
    ("Should an animal appear, brake.", ""),
    ("Lon: accelerate | maintain | decelerate", ""),
    ("Options: (1) accelerate, (2) turn left. Decision: slow down.", "lon=decelerate"),
    ("Options:\n- stop\n- accelerate\n\nDecision: keep speed", "lon=maintain"),
    ("Options: (a) accelerate (b) stop. Answer: b", "lon=stop"),
    ("Plan: keep speed. Not recommended: stop; turn left.", "lon=maintain"),
    ("Previous decision: stop\nDecision: accelerate", "lon=accelerate"),
    ('The plan changes from "accelerate" to "brake".', "lon=decelerate"),
    ("Decision: ~~keep speed~~ slow down", "lon=decelerate"),
    ("Brake, without swerving.", "lon=decelerate"),
    ("Slow down since he comes over, and will hit us unless we act.", "lon=decelerate"),
    (
        "Change to the left lane (nobody beside or behind us), at an unchanged speed.",
        "lon=maintain lat=left",
    ),
    ('{"previous_plan": "stop", "current_plan": "accelerate"}', "lon=accelerate"),
    ("| van | ahead | parked | potential | decelerate | straight |", "lon=decelerate lat=straight"),
    ("Cancel the right turn. Keep your lane.", "lat=straight"),
    ('Not "slow" but stop.', "lon=stop"),
    ("(i) lane change to the left, rejected, since a bus is there; (ii) brake.", "lon=decelerate"),
]

ORDER = [
    ("Keep the speed; move left, and come back to the right afterwards.", "lon=maintain lat=left"),
    ("Meta actions: 1. keep lane, keep speed 2. turn left 3. stop", "lon=maintain lat=straight"),
    ("Meta actions:\n1. DECELERATE, KEEP LANE\n2. ACCELERATE, CHANGE LANE LEFT",
     "lon=decelerate lat=straight"),
    ("Turn right after yielding to the cyclists.", "lon=decelerate lat=right"),
    ("Decision: slow down -> revised: stop", "lon=stop"),
    ("Follow the lorry at constant speed.", "lon=maintain"),
    ("Brake hard, a crash is imminent otherwise.", "lon=decelerate"),
    ("Slow down now: a crash follows unless we act.", "lon=decelerate"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "told"), PACE + HALTS + LATERAL + INTENTIONS + NOT_CHOSEN + ORDER)
def test_plan(text: str, told: str) -> None:
    found = extract(text)
    slots = (("lon", found.lon_action), ("lat", found.lat_action))
    assert " ".join(f"{name}={slot.value}" for name, slot in slots if slot) == told
