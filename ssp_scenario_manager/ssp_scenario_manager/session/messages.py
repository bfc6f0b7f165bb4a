"""SessionState and TriggerEvent as bytes."""

from __future__ import annotations

from ssp_core.cdr.codec import ENCAPSULATION, write
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.session.outbox import StateChanged, TriggerDecision


def encode_session_state(change: StateChanged, spec: RunSpec | None) -> bytes:
    """Encode SessionState.msg, in frame map.

    Args:
        change: the transition.
        spec: the run that is loaded, if any.

    Raises:
        ValueError: what its fields can't hold.
    """
    run = ("", "", "") if spec is None else (spec.run_id, spec.scenario, spec.event_version)
    values = [change.stamp_ns, change.state, change.previous, change.event, change.reason, *run]
    values += [change.verdict, len(change.reasons), *change.reasons]
    return ENCAPSULATION + write("mBBtttttBI" + "t" * len(change.reasons), values)


def encode_trigger(fired: TriggerDecision, processing_s: float) -> bytes:
    """Encode TriggerEvent.msg, in frame map.

    Args:
        fired: the decision record.
        processing_s: time from the arrival of the deciding state to the dispatch.

    Raises:
        ValueError: what its fields can't hold.
    """
    samples, objects, references = fired.samples, fired.object_ids, fired.reference_ids
    layout = "mttdI" + "s" * len(samples) + "I" + "d" * len(samples) + "ssdI"
    values = [fired.stamp_ns, fired.trigger_id, fired.condition, fired.threshold]
    values += [len(samples), *(one.stamp_ns for one in samples)]
    values += [len(samples), *(one.value for one in samples)]
    values += [fired.crossing_ns, fired.dispatched_ns, processing_s]
    values += [len(objects), *objects, len(references), *references]
    layout += "t" * len(objects) + "I" + "t" * len(references)
    return ENCAPSULATION + write(layout, values)
