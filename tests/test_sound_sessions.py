"""Sound recordings by seeds: what judges those of others finds nothing wrong in them.

Drawn sessions are judged by their true states, live ones by what the participants report: places
to 2 cm, late, with losses. Of each kind of recording of others one seed is imported here, and
thirty by ``tests/sound_recordings.py``.
"""

from __future__ import annotations

import pytest

from tests.sound_recordings import KINDS, refusal


@pytest.mark.parametrize("seed", range(30))
def test_a_sound_session_is_taken_without_a_word(seed: int) -> None:
    assert [refusal(kind, seed) for kind in ("raster", "live")] == ["", ""]


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("raster", "live")])
def test_a_sound_recording_of_others_is_taken(kind: str) -> None:
    assert refusal(kind, 7) == ""
