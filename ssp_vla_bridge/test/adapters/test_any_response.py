"""Every adapter on every response: nothing raises, nothing invalid is called valid."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_vla_bridge.adapters.registry import ADAPTERS, adapt
from ssp_vla_bridge.messages import (
    EgoSample,
    NativeArray,
    Request,
    Response,
    response_from_json,
    response_to_json,
)
from ssp_vla_bridge.trajectory import INVALID_REASONS, check_trajectory

NAMES = [f"{name}:{mode}" for name, adapter in ADAPTERS.items() for mode in adapter.modes]

number = st.sampled_from(["5.0", "-0.2", "0", ".5", "4.", "1e3", "nan", "-inf", "1e400", "\u22121"])
row = st.builds("{}{}, {}{}".format, st.sampled_from(["[", "("]), number, number, st.just("]"))
rows = st.builds(
    lambda one, count, joint: joint.join([one] * count),
    row,
    st.integers(1, 22),
    st.sampled_from([", ", "\n", " "]),
)
piece = (
    rows
    | st.text(max_size=5)
    | st.sampled_from(
        ["[", "]", "3-second trajectory: ", "</think>", "Observed: ", "...", "['", "']", ",", "**"]
    )
)
text = st.lists(piece, max_size=8).map("".join)
wide = st.floats() | st.sampled_from([0.0, 0.1, 0.5])
array = st.builds(
    NativeArray,
    name=st.sampled_from(["trajectory", "pred_xyz", "other"]),
    shape=st.lists(st.integers(-1, 4), max_size=6).map(tuple),
    data=st.lists(wide, max_size=12).map(tuple),
    frame=st.sampled_from(["ego_xy", "ego_xyz", "map"]),
    unit=st.sampled_from(["m", "px"]),
    step_s=wide,
    first_time_s=wide,
)
offset = wide | st.integers(-9, 99)
stage = st.fixed_dictionaries(
    {},
    optional={
        "name": st.just("motion"),
        "start": wide | st.integers(-9, 99),
        "end": wide | st.integers(-9, 99),
    },
)
response = st.builds(
    Response,
    request_id=st.just("r"),
    stamp_ns=st.just(0),
    model=st.just("m"),
    model_id=st.just("m/1"),
    text=text,
    arrays=st.lists(array, max_size=2).map(tuple),
    decoding=st.just({}) | st.fixed_dictionaries({"stages": st.lists(stage, max_size=2)}),
    error_code=st.sampled_from([0, 0, 0, 2]),
)
sample = st.builds(EgoSample, *[st.sampled_from([0.0, -0.5, -1.0, -1.5, 5.0]) | st.floats()] * 6)
request = st.none() | st.builds(
    Request,
    request_id=st.just("r"),
    stamp_ns=st.just(0),
    frames=st.just(()),
    history=st.lists(sample, max_size=12).map(tuple),
    ego_provenance=st.sampled_from(["measured", "unknown"]),
)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=150, deadline=None)
@given(response, request)
def test_there_is_a_valid_trajectory_or_a_reason(name, given_response, given_request):
    adapted = adapt(name, given_response, given_request)
    assert (adapted.trajectory is None) == bool(adapted.invalid)
    assert set(adapted.invalid) <= set(INVALID_REASONS)
    if given_response.error_code:
        assert adapted.invalid == ("missing",)
    if adapted.trajectory is not None:
        assert check_trajectory(adapted.trajectory) == ()
    assert name == f"{adapted.info.name}:{adapted.info.mode}"
    assert len(set(adapted.info.notes)) == len(adapted.info.notes)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=30, deadline=None)
@given(response)
def test_a_stored_response_is_read_like_the_one_before(name, given_response):
    again = response_from_json(response_to_json(given_response))
    assert adapt(name, again) == adapt(name, given_response)
