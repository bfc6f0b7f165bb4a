"""ISO/TS 18571: the library's ratings are those of a second implementation from the definition."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from ssp_core.geometry import FloatArray
from ssp_eval.response.iso18571 import rate
from tests.support.braking import pulse
from tests.support.iso18571 import rating

FIGURES = Path(__file__).with_name("iso18571_figures.json")
# Name of a case: seconds late, gain, noise in m/s², length in s, step in s.
CASES = {
    "the same": (0.0, 1.0, 0.0, 3.0, 0.01),
    "late": (0.1, 1.0, 0.0, 3.0, 0.01),
    "early": (-0.15, 1.0, 0.0, 3.0, 0.01),
    "weaker": (0.0, 0.9, 0.0, 3.0, 0.01),
    "stronger": (0.0, 1.25, 0.0, 3.0, 0.01),
    "late and weaker": (0.2, 0.8, 0.0, 3.0, 0.01),
    "later than may be": (0.9, 1.0, 0.2, 3.0, 0.01),
    "with noise": (0.05, 0.95, 0.3, 3.0, 0.01),
    "with much noise": (0.0, 1.0, 1.5, 3.03, 0.01),
    "the other way round": (0.0, -1.0, 0.1, 3.0, 0.01),
    "short": (0.04, 0.9, 0.1, 0.8, 0.02),
    "coarse": (0.1, 1.1, 0.2, 3.1, 0.05),
}


def curves(case: str) -> tuple[FloatArray, FloatArray, float]:
    """Reference, comparison and step of a case."""
    late_s, gain, noise, length_s, step_s = CASES[case]
    t_s = step_s * np.arange(round(length_s / step_s))
    drawn = np.random.default_rng(18571).normal(0.0, 1.0, (2, len(t_s)))
    return pulse(t_s) + noise * drawn[0], gain * pulse(t_s - late_s) + noise * drawn[1], step_s


def test_the_library_gives_what_a_second_implementation_gives() -> None:
    stored = json.loads(FIGURES.read_text())
    assert {figures["case"] for figures in stored} == set(CASES)
    for figures in stored:
        found = asdict(rate(*curves(figures.pop("case"))))
        assert found == pytest.approx(figures, abs=1e-3)


@pytest.mark.parametrize("case", ["late", "weaker", "with noise", "short"])
def test_the_stored_figures_are_those_of_the_second_implementation(case: str) -> None:
    stored = next(one for one in json.loads(FIGURES.read_text()) if one.pop("case") == case)
    reference, comparison, step_s = curves(case)
    assert rating(reference.tolist(), comparison.tolist(), step_s) == pytest.approx(
        stored, abs=1e-6
    )


def test_unaligned_a_tenth_of_a_second_and_a_tenth_of_the_braking_cost_a_tenth() -> None:
    # 3 s with 0.2 s before the braking: 0.3 s to -7 m/s², 1.5 s of it, 0.5 s back, 0.5 s after.
    late, weaker = rate(*curves("late")), rate(*curves("weaker"))
    assert late.overall == pytest.approx(0.90, abs=0.005)
    assert (late.magnitude, late.slope) == pytest.approx((1.0, 1.0), abs=1e-3)
    assert weaker.overall == pytest.approx(0.91, abs=0.005)
    assert (weaker.phase, weaker.slope) == pytest.approx((1.0, 0.95), abs=1e-3)
    assert rate(*curves("the same")).overall == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("reference", "comparison", "text"),
    [
        (np.zeros(300), np.zeros(300), "constant"),
        (np.arange(300.0), np.arange(299.0), "differ"),
        (np.arange(8.0), np.arange(8.0), "samples"),
        (np.arange(2600.0), np.arange(2600.0), "samples"),
        (np.arange(300.0), np.full(300, np.nan), "finite"),
    ],
)
def test_curves_that_cannot_be_rated_are_refused(
    reference: FloatArray, comparison: FloatArray, text: str
) -> None:
    with pytest.raises(ValueError, match=text):
        rate(reference, comparison, 0.01)


def test_the_library_is_imported_when_a_pair_is_rated() -> None:
    code = (
        "import sys, ssp_eval.audit.cli, ssp_eval.package.verify\n"
        "heavy = {'pandas', 'seaborn', 'dtwalign', 'matplotlib', 'networkx', 'shapely'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "[]"


def test_rating_loads_nothing_that_draws() -> None:
    code = (
        "import sys, numpy, ssp_eval.response.iso18571 as iso\n"
        "iso._metric()\n"
        "print(sorted({'matplotlib', 'networkx', 'pandas', 'seaborn'} & set(sys.modules)))\n"
        "import networkx; networkx.DiGraph()"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "[]"
