"""PhaseEvent, SafetyEvent and FaultEvent as bytes."""

from __future__ import annotations

from ssp_core.cdr.codec import ENCAPSULATION, fields_of, write
from ssp_core.motion.event import PhaseBegan
from ssp_core.safety.codes import MEANINGS
from ssp_core.world.plant import FaultFact, LimitFact

_PHASE = "mBt?"
_SAFETY = "mHtttddttt"
_FAULT = "mttt?dt"


def encode_phase(began: PhaseBegan) -> bytes:
    """Encode a PhaseEvent.msg, in frame map; raise ValueError for what its fields can't hold."""
    values = [began.stamp_ns, began.phase, began.evidence, began.phase.is_provisional]
    return ENCAPSULATION + write(_PHASE, values)


def encode_limit(
    passed: LimitFact, reaction: str = "abort", *, name: str = "", unit: str = ""
) -> bytes:
    """Encode a SafetyEvent.msg, in frame map; raise ValueError for what its fields can't hold.

    Args:
        passed: the limit, and what was measured.
        reaction: what follows from it, ``abort`` or ``local_stop``.
        name: of the limit, where it isn't the one that its code usually stands for.
        unit: of such a limit.
    """
    meaning = MEANINGS[passed.code]
    values = [
        passed.stamp_ns,
        passed.code,
        name or meaning.limit_name,
        passed.source,
        passed.object_id,
        passed.measured,
        passed.limit,
        unit or meaning.unit,
        reaction,
        passed.words,
    ]
    return ENCAPSULATION + write(_SAFETY, values)


def encode_fault(fault: FaultFact) -> bytes:
    """Encode a FaultEvent.msg, in frame map; raise ValueError for what its fields can't hold."""
    *fields, stamp_ns = fields_of(fault)
    return ENCAPSULATION + write(_FAULT, [stamp_ns, *fields])
