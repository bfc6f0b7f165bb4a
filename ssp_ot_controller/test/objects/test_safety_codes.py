"""The table of safety codes is complete and its numbers don't move."""

from __future__ import annotations

from ssp_core.safety.codes import MEANINGS, SafetyCode


def test_every_code_has_a_meaning_of_its_own() -> None:
    assert set(MEANINGS) == set(SafetyCode)
    names = [m.limit_name for m in MEANINGS.values()]
    assert len(set(names)) == len(names)
    assert all(m.text.endswith(".") for m in MEANINGS.values())
    assert all(m.limit_name == code.name.lower() for code, m in MEANINGS.items())


def test_numbers_are_fixed_and_tell_who_saw_it() -> None:
    values = [c.value for c in SafetyCode]
    own = [value for value in values if value < 20]
    assert own == list(range(1, 1 + len(own)))
    assert values[len(own) :] == list(range(20, 20 + len(values) - len(own)))
    assert SafetyCode(1) is SafetyCode.HEARTBEAT_LOST
    assert SafetyCode(20) is SafetyCode.SEPARATION
    assert SafetyCode(30) is SafetyCode.OPERATOR
