"""Sound sessions of thirty seeds: what judges recordings of others finds nothing in their states.

Drawn sessions are judged by their true states, live ones by what the participants report: places to
2 cm, late, with losses.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import LinkDisturbance
from ssp_eval.audit.history import find_switches
from ssp_eval.importers.contradictions import Course, contradictions
from ssp_eval.recordings.states import Sighting
from ssp_scenario_manager.run.in_process import run_in_process
from tests.support.adaptation import base

MEASURED = LinkDisturbance(
    position_noise_m=0.02,
    speed_noise_mps=0.03,
    state_jitter_s=0.01,
    state_loss=0.02,
    reorder=0.02,
)


def course_of(states: Sequence[ObjectState]) -> Course:
    """The states as an import holds them: in the order of their stamps, each stamp once."""
    by_stamp = {state.stamp_ns: state for state in states}
    kept = [by_stamp[stamp_ns] for stamp_ns in sorted(by_stamp)]
    places = np.array([(state.x_m, state.y_m) for state in kept])
    times_s = np.array([1e-9 * (state.stamp_ns - kept[0].stamp_ns) for state in kept])
    yaws, speeds = (
        np.array([getattr(state, name) for state in kept]) for name in ("yaw_rad", "speed_mps")
    )
    return Course(kept[0].object_class, times_s, places, places, yaws, speeds)


def sightings_of(who: str, states: Sequence[ObjectState]) -> list[Sighting]:
    return [
        Sighting(
            1e-9 * state.stamp_ns, who, state.object_id, state.object_class.word,
            state.x_m, state.y_m, state.speed_mps,
        )
        for state in sorted(states, key=lambda state: state.stamp_ns)
    ]  # fmt: skip


@pytest.mark.parametrize("seed", range(30))
def test_a_sound_session_is_taken_without_a_word(seed: int) -> None:
    run = base("cut_in" if seed % 2 else "vru_crossing")
    cruise_mps = run.driver.cruise_mps * (0.9 + 0.005 * seed)
    driver = run.driver.model_copy(update={"cruise_mps": cruise_mps})
    changes = {"seed": seed, "driver": driver, "disturbance": MEASURED}
    run = run.model_copy(update=changes)
    _, record = run_in_process(run)
    for who in run.object_ids:
        for states in (record.truths(who), record.arrived(who)):
            assert len(states) > 100
            assert contradictions(course_of(states)) == [], (seed, who)
            seen = sightings_of(who, states)
            steps = max(after.t_s - before.t_s for before, after in pairwise(seen))
            assert steps < 0.5
            assert find_switches(seen, [who], [], seen[0].t_s, seen[-1].t_s) == []
