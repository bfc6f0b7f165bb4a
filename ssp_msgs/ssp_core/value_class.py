"""Frozen dataclasses that are made in every step of a session.

The guard of a frozen dataclass sets each field through ``object.__setattr__``, which takes four
times as long as making the object without it: a sixth of a session. The type checker sees frozen
dataclasses, and refuses what changes one; at run time the guard isn't there.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass as value_class
else:
    from dataclasses import dataclass

    def value_class(*, frozen, slots):
        """Make a dataclass with the equality and hash of a frozen one, and without its guard."""
        return dataclass(slots=slots, unsafe_hash=frozen)


__all__ = ["value_class"]
