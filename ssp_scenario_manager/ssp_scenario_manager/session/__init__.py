"""The session: its states and commands, the run, and its supervision. Without ROS or a clock.

The way of a state of the VUT to a reference:

1. ``ssp_core.cdr.states.decode_state`` reads the message,
2. ``ros.manager_node.ScenarioManager.on_vut_state`` takes it,
3. ``inputs.StateInput.vut`` counts it and notes who was heard,
4. ``session.Session.on_vut_state`` keeps it, and ``run.Run.see`` judges it by those before it,
5. ``session.Session.judge_triggers`` asks each trigger:
6. ``triggers.evaluator.TriggerWatch.observe`` says whether it fires, and then
7. ``dispatch.references.manoeuvre_reference`` plans what it sends;
8. ``ros.endpoints.ObjectEndpoints.send`` publishes that.

``Session.step`` follows with limits, phases, adapted references and the end of the run.

Everywhere here ``now_ns`` is session time and ``steady_ns`` the steady clock; none is read here.
"""
