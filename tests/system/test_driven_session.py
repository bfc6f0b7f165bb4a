"""A driver in a process of its own: its session has the states of the run in one process."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from ssp_core.bag.reader import BagReader

pytestmark = [pytest.mark.ros, pytest.mark.system]


def test_a_driver_leads_the_vut_over_dds_to_the_states_of_one_process(start_session: Any) -> None:
    """Its outcome would be ``harness`` otherwise: each session is held against one process."""
    session = start_session("cut_in", "--drive", "oracle", "--latency", "fixed:0.2", name="driven")
    result = session.finish()
    assert (result["verdict"], result["in_process"]) == ("valid", False), session.lines
    driven = result["driven"]
    assert (driven["outcome"], driven["why"]) == ("avoided", "no contact until T_end")
    assert "oracle: avoided at" in session.out
    with BagReader(session.folder / "bag") as bag:
        counts = Counter(message.topic for message in bag.messages())
    assert counts["/ssp/vla/oracle/request"] == driven["questions"]
    assert counts["/ssp/vla/oracle/response"] == driven["answers"]
    assert counts["/ssp/vut/reference_ack"] == driven["answers"]
    assert counts["/ssp/vut/reference"] > 50
