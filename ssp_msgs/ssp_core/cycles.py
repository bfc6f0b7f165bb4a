"""The search for cycles among the objects of a program, which takes a tenth of its start.

What a program imports stays until its end: looking through it finds nothing.
"""

from __future__ import annotations

import gc

# New objects between two searches while a program starts: a node makes half as many.
STARTING = 200_000
_USUAL = gc.get_threshold()


def put_search_off() -> None:
    """Look for cycles only among very many new objects, until ``search_as_usual``."""
    gc.set_threshold(STARTING, *_USUAL[1:])


def search_as_usual() -> None:
    """Look as often as Python does by itself, and never through what is there already."""
    gc.freeze()
    gc.set_threshold(*_USUAL)
