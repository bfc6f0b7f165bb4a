"""The names of the fields of structured answers, as data."""

from __future__ import annotations

from ssp_eval.extract.rules.words.notation import Table, phrases

# Field names of structured answers, valid only in front of a colon or an equals sign.
KEYS: Table = {
    "objects": phrases(
        """
        objects, object, critical objects, critical object, road users, object class,
        class, agents, critical road users, relevant objects, actors, actor, agent,
        critical agent, type, road user, object list, list of objects, traffic participants,
        traffic participant, most critical, most critical object, critical participant,
        critical participants, vru, key object, key objects, participants, participant, hazard,
        object category, category, main object, who, what, relevant object, relevant road users,
        relevant road user, detected objects, main actor, key actor, critical actor, most relevant
        """
    ),
    "position": phrases(
        """
        position, location, relative position, where, object position, pos, loc, where is it,
        relative location, placement, whereabouts, bearing, rel pos, object location, where it is,
        position relative to ego, position relative to us, position relative to the ego
        """
    ),
    "motion": phrases(
        """
        motion, movement, motion state, behavior, behaviour, object motion, how it moves,
        movement state, doing what, what it does, what is it doing, how does it move, dynamics,
        object movement, motion status, moves, doing, kinematics, object behavior,
        object behaviour, what it is doing, its motion, relative motion, motion pattern
        """
    ),
    "conflict": phrases(
        """
        potential conflict, potential conflicts, conflicts, potential risk, potential
        risks, potential hazard, potential hazards, hazards, collision risk, conflict,
        conflict status, conflict state, risk, conflict level, risk level, interaction,
        risk status
        """
    ),
    "lon_action": phrases(
        """
        lon action, longitudinal, longitudinal action, speed action, lon, longitudinal
        plan, speed plan, speed decision, longitudinal decision
        """
    ),
    "lat_action": phrases(
        """
        lat action, lateral, lateral action, steering, lat, path decision, lateral plan,
        steering action, lateral decision
        """
    ),
    "action": phrases(
        """
        action, actions, correct action, meta action, meta actions, driving plan, plan,
        decision, final decision, maneuver, manoeuvre, final action, final plan, ego
        action, driving action, intent, intention, driving intent, intent description,
        driving intent description, intended action, future intent, intended behavior,
        intended behaviour, ego intent, plan of action, recommended action, recommendation,
        recommended, command, commands, ego plan, next action, next step, next move, ego response,
        selected action, chosen action,
        action now, intent of the ego, driving intention, ego behavior, ego behaviour, new
        decision, new plan, new action, our plan, our action, selected, chosen, planned action,
        command to the vehicle, driving decision, ego decision, meta driving action, verdict,
        recommended maneuver, recommended manoeuvre, selection, current plan, present plan,
        current decision, current action, present decision, choice, response, our decision,
        instruction to the vehicle
        """
    ),
}
