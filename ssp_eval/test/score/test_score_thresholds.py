"""Comparisons with their tolerance (METHOD 6.11), for one number and for many."""

import math
from dataclasses import asdict

import numpy as np
import pytest

from ssp_core.errors import InputError
from ssp_eval.score.thresholds import Thresholds, thresholds_of

QUARTER = Thresholds(tolerance=0.25)


@pytest.mark.parametrize(
    ("value", "most", "least"),
    [
        (0.5, True, False),
        (0.75, True, True),
        (1.0, True, True),
        (1.25, True, True),
        (1.5, False, True),
        (math.nan, False, False),
        (math.inf, False, True),
        (-math.inf, True, False),
    ],
)
def test_both_ends_of_the_tolerance_are_inside(value, most, least):
    assert QUARTER.at_most(value, 1.0) is most
    assert QUARTER.at_least(value, 1.0) is least
    many = np.array([value, value])
    assert QUARTER.at_most(many, 1.0).tolist() == [most, most]
    assert QUARTER.at_least(many, 1.0).tolist() == [least, least]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"tolerance": "0.1"},
            "must be numbers by name; put the file back, or evaluate the cell again",
        ),
        (
            {"speed": 1.0, "room": 2.0},
            "names other thresholds than this version has (got 'room, speed'); evaluate it again; "
            "stored answers aren't asked again",
        ),
    ],
)
def test_a_result_names_the_thresholds_of_this_version(changed, message):
    values = asdict(QUARTER)
    assert thresholds_of(values, "cell.json") == QUARTER
    with pytest.raises(InputError) as raised:
        thresholds_of(values | changed, "cell.json")
    assert str(raised.value) == f"cell.json: thresholds: {message}"
