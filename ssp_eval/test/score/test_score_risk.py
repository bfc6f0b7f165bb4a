"""METHOD 6.9 on lists of candidates."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from ssp_eval.data.labels import Label, Labels
from ssp_eval.score.columns import NOTHING
from ssp_eval.score.engine import BatchTerms, cell_terms, responses, score_terms
from ssp_eval.score.thresholds import Thresholds


@dataclass
class Response:
    """The candidate that begins it, and the cell's RSR and RL."""

    record: int | None
    success: int
    latency_s: float | None


def run(pattern, times, onset=0.0, **changed):
    """``D`` is a defensive candidate, ``-`` one that isn't; a label without a record follows."""
    thresholds = Thresholds(**changed)
    count = len(pattern)
    label = Label(0.0, "conflict", True, (), None, None, "active", ("stop",), ("straight",))
    labels = tuple(replace(label, t_s=10.0 * place) for place in range(count + 1))
    terms = replace(
        cell_terms(Labels("s", "physical", "v", onset, True, labels), [], thresholds),
        candidate=np.arange(count + 1) < count,
        defensive=np.array([*(mark == "D" for mark in pattern), False]),
        record_t_s=np.array([*times, np.nan]),
    )
    cells = BatchTerms(terms, np.array([0, count + 1]), np.array([onset]))
    (row,) = responses(cells, thresholds).tolist()
    (score,) = score_terms(cells, thresholds).cells()
    return Response(None if row == NOTHING else row, score.rsr, score.rl_s)


@pytest.mark.parametrize(
    ("pattern", "times", "record"),
    [
        ("", [], None),
        ("D", [1.0], None),
        ("DD", [1.0, 1.5], 0),
        ("D-D", [1.0, 1.2, 1.4], None),
        ("-DD", [1.0, 1.5, 2.0], 1),
        ("D-DD", [1.0, 1.5, 2.0, 2.5], 2),
        ("DDD", [1.0, 1.7, 2.2], 1),
        ("DD", [1.0, 1.6], 0),
        ("DD", [1.0, 1.6000000005], 0),
        ("DD", [1.0, 1.600000002], None),
        ("DD", [1.0, 1.0], None),
        ("DD", [1.0, 1.0000001], 0),
    ],
)
def test_first_run_of_two(pattern, times, record):
    assert run(pattern, times).record == record


@pytest.mark.parametrize(
    ("onset", "latency"), [(0.25, 0.75), (1.0, 0.0), (1.0000000005, 0.0), (-1.0, 2.0)]
)
def test_latency_is_measured_from_the_onset_and_never_negative(onset, latency):
    response = run("DD", [1.0, 1.5], onset)
    assert (response.success, response.latency_s) == (1, latency)


def test_without_a_response_there_is_no_latency():
    assert run("D-", [1.0, 1.5]).latency_s is None
    assert run("D-", [1.0, 1.5]).success == 0


def test_a_longer_run_can_be_asked_for():
    times = [1.0, 1.5, 2.0, 2.5]
    assert run("DD-D", times, response_count=3).record is None
    assert run("-DDD", times, response_count=3).record == 1
    assert run("-DDD", [1.0, 1.5, 2.0, 2.7], response_count=3).record is None
