"""Models follow a session in shadow mode: their answers are in its bag, no more."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import peek_stamp_ns

pytestmark = [pytest.mark.ros, pytest.mark.system]
IMAGE = "/ssp/vut/front_camera/image/compressed"


def test_answers_are_recorded_by_their_frames_stamps_and_a_dead_model_costs_nothing(
    start_session: Any,
) -> None:
    session = start_session(
        "cut_in",
        *("--shadow", 'blind={"backend": "constant_velocity", "hz": 4}'),
        *("--shadow", 'gone={"backend": "no_such_backend"}'),
    )
    result = session.finish()
    assert (result["verdict"], session.process.returncode) == ("valid", 0), session.lines
    assert any("the bridge of gone exited" in line for line in session.lines), session.lines
    assert any("the session goes on without it" in line for line in session.lines)
    with BagReader(session.folder / "bag") as bag:
        assert "/ssp/vla/gone/response" not in bag.topics
        frames = [peek_stamp_ns(m.data) for m in bag.messages([IMAGE])]
        answers = [bag.decode(m) for m in bag.messages(["/ssp/vla/blind/response"])]
        diagnostics = [bag.decode(m) for m in bag.messages(["/diagnostics"])]
    stamps = [a.header.stamp.sec * 10**9 + a.header.stamp.nanosec for a in answers]
    # How many there are depends on the machine; each is about a frame, and they are apart.
    assert len(answers) >= 3
    assert set(stamps) <= set(frames)
    assert all(after - before >= 230_000_000 for before, after in pairwise(stamps))
    good = [a for a in answers if not a.error_code]
    assert good
    assert all("frames_ns" in a.decoding and a.text for a in good)
    names = {status.name for one in diagnostics for status in one.status}
    assert names == {"ssp: vla_bridge blind"}
