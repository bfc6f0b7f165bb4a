"""What the process of a live object knows of its body (BodyStatus.msg)."""

from __future__ import annotations

from dataclasses import dataclass

# Told twice a second; what was told longer ago is forgotten.
PERIOD_S = 0.5
FORGOTTEN_S = 2.0


@dataclass(frozen=True, slots=True)
class BodyStatus:
    """What keeps one object from being seen and armed, as sentences; empty: nothing.

    Args:
        no_state: why no states are made of what its body says.
        cannot_arm: all that keeps it from being armed.
        lasting: one of ``cannot_arm`` stays as long as the process runs as it was started.
    """

    object_id: str
    no_state: tuple[str, ...] = ()
    cannot_arm: tuple[str, ...] = ()
    lasting: bool = False
