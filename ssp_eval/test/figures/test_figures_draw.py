"""The figures hold a mark for every number, and no text lies on another or is cut off."""

from __future__ import annotations

import itertools
import re
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import pytest
from matplotlib.colors import to_rgb
from matplotlib.text import Text

from ssp_core.vocabulary import DOMAINS
from ssp_eval.figures.domains import domains
from ssp_eval.figures.foundation import foundation
from ssp_eval.figures.matrix import matrix
from ssp_eval.figures.models import models
from ssp_eval.figures.scores import Scores, pareto_front, words
from ssp_eval.figures.style import (
    COMPONENT_LOOKS,
    DOMAIN_LOOKS,
    SMALL_PT,
    Drawing,
    LeftOut,
    drawing,
)
from ssp_eval.score.aggregate import ranking
from ssp_eval.score.metrics import ivcs_weights
from ssp_eval.statistics.rows import CellRow
from tests.support.score_rows import MANY, MODELS, rows_of

KINDS = {
    "matrix": matrix,
    "domains": domains,
    "models": lambda scores: models(scores, None),
    "foundation": foundation,
}
CONTROLS = ("+black", "+shuffled", "perfect", "silent", "constant_velocity", "copy_history")
CASES = {
    "controls": [
        *rows_of(MANY[:3]),
        *(
            replace(row, model=f"{row.model}{name}" if name[0] == "+" else name, control=True)
            for name in CONTROLS
            for row in rows_of(MANY[:3] if name[0] == "+" else MANY[:1])
        ),
    ],
    "18 cells": rows_of(),
    "30 models": rows_of(MANY),
    "4 scenarios": rows_of(scenarios=("a", "b_much_longer_than_the_others", "c", "d")),
    "one cell": rows_of(MODELS[:1], ("cut_in",))[:1],
    "one domain": [row for row in rows_of() if row.domain == "physical"],
    "none admitted": [replace(row, admitted=False) for row in rows_of()],
    "all the same": [
        replace(row, jovr=0.5, sem_acc_eff=0.5, cia_eff=0.5, tqsr=0.5, rsr=0.0, rl_s=None)
        for row in rows_of()
    ],
    "odd names": [
        replace(row, model=f"{row.model} $a_b$ 模型 <&>", scenario=f"{row.scenario} \\frac")
        for row in rows_of()
    ],
}
LOOKED_AT_AGAIN = ("18 cells", "30 models")


@pytest.fixture(autouse=True)
def _strict() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with drawing():
            yield


def drawings_of(rows: list[CellRow], kind: str) -> dict[str, Drawing]:
    """The drawings of one kind by name."""
    found = KINDS[kind](Scores(tuple(rows)))
    return {one.name: one for one in found if isinstance(one, Drawing)}


@cache
def cached_drawings(case: str, kind: str) -> dict[str, Drawing]:
    """The drawings of a case that several tests look at, and none changes."""
    return drawings_of(CASES[case], kind)


def gids(figure: Drawing) -> Counter[str]:
    """Count the artists of a drawing by the first word of their name."""
    names = [artist.get_gid() for artist in figure.figure.findobj() if artist.get_gid()]
    return Counter(name.split("-")[0] for name in names)


def texts_of(figure: Drawing) -> list[tuple[str, tuple[float, float, float, float], float]]:
    """Visible texts with their rectangles in px and size in pt."""
    renderer = figure.figure.canvas.get_renderer()
    figure.figure.draw_without_rendering()
    return [
        (text.get_text(), text.get_window_extent(renderer).extents, text.get_size())
        for text in figure.figure.findobj(Text)
        if text.get_visible() and text.get_text().strip()
    ]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("case", CASES)
def test_no_text_lies_on_another_is_cut_off_or_too_small(case: str, kind: str) -> None:
    found = (
        cached_drawings(case, kind) if case in LOOKED_AT_AGAIN else drawings_of(CASES[case], kind)
    )
    for name, figure in found.items():
        width, height = figure.figure.canvas.get_width_height()
        texts = texts_of(figure)
        assert texts
        for text, (left, bottom, right, top), size in texts:
            where = f"{name}: {text!r}"
            assert size >= SMALL_PT, where
            assert min(left, bottom) >= -1, where
            assert right <= width + 1, where
            assert top <= height + 1, where
        for (a, one, _), (b, other, _) in itertools.combinations(texts, 2):
            # Letters without descenders leave a px of air in their rectangles.
            apart = (
                one[2] <= other[0] + 1
                or other[2] <= one[0] + 1
                or one[3] <= other[1] + 2
                or other[3] <= one[1] + 2
            )
            assert apart, f"{name}: {a!r} lies on {b!r}"


def test_a_matrix_has_a_mark_for_every_score_and_says_what_was_refused() -> None:
    rows = rows_of()
    rows[0] = replace(rows[0], status="refused", reason="failed_safety: fence")
    rows[1] = replace(rows[1], admitted=False)
    rows[2] = replace(rows[2], control=True)
    rows[3] = replace(rows[3], cia_eff=None)
    found = drawings_of(rows, "matrix")
    figure, of_controls = found["matrix"], found["matrix_controls"]
    assert (gids(figure)["score"], gids(of_controls)["score"]) == (16 * 6, 6)
    assert "enter no mean" in of_controls.caption
    assert "enter no mean" not in figure.caption
    assert gids(figure)["refused"] == 1
    texts = [text for text, _, _ in texts_of(figure)]
    assert "refused: failed_safety: fence" in texts
    assert f"{rows[1].model} †" in texts
    nulls = sum(row.cia_eff is None for row in (rows[1], *rows[3:]))
    assert texts.count("–") == nulls > 0
    for row in (rows[1], *rows[3:]):
        assert sum(text.startswith(f"{row.ivcs:.3f}") for text in texts) >= 1
    assert "1 refused or failed" in figure.caption
    assert "1 not admitted" in figure.caption


def test_thousands_of_pages_are_drawn_when_they_are_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rows = Scores(tuple(rows_of(MANY[:9])))
    monkeypatch.setattr("ssp_eval.figures.matrix.MOST_PAGES", 1)
    (left_out,) = matrix(rows)
    assert isinstance(left_out, LeftOut)
    assert left_out.reason == "54 cells are 2 pages; ask for them with --only matrix"
    assert len(list(matrix(rows, whole=True))) == 2


def test_a_large_matrix_goes_over_pages_without_losing_a_cell() -> None:
    rows, pages = CASES["30 models"], cached_drawings("30 models", "matrix")
    assert list(pages) == [f"matrix_{k}" for k in range(1, len(pages) + 1)]
    assert len(pages) > 1
    assert sum(gids(page)["score"] for page in pages.values()) == len(rows) * 6
    assert all(page.figure.get_figheight() <= 9.0 for page in pages.values())


def test_means_of_runs_are_one_row_and_a_share_of_responses() -> None:
    (row,) = CASES["one cell"]
    runs = [replace(row, seed=k, rsr=float(k > 0), rl_s=0.5 if k else None) for k in range(4)]
    figure = drawings_of(runs, "matrix")["matrix"]
    assert gids(figure)["score"] == 6
    assert "75 %" in [text for text, _, _ in texts_of(figure)]
    assert "several runs" in figure.caption
    lost = replace(row, seed=9, status="failed", reason="bridge died")
    figure = drawings_of([*runs, lost], "matrix")["matrix"]
    assert gids(figure)["score"] == 6
    assert f"Runs without a score, which their cells leave out: {' / '.join(row.key)}: bridge" in (
        figure.caption
    )


def test_marks_of_domains_are_the_means_and_the_stacks_add_up_to_ivcs() -> None:
    scores = Scores(tuple(CASES["18 cells"]))
    figures = cached_drawings("18 cells", "domains")
    marks = {
        artist.get_gid(): artist.get_xdata()[0]
        for artist in figures["domains_components"].figure.findobj()
        if (artist.get_gid() or "").startswith("mean-")
    }
    assert marks == {
        f"mean-{key}-{domain}": scores.by_domain[domain][key].value
        for key in ivcs_weights()
        for domain in DOMAINS
    }
    bars = {
        artist.get_gid(): artist.get_width()
        for artist in figures["domains_contributions"].figure.findobj()
        if (artist.get_gid() or "").startswith("part-all scenarios-")
    }
    for domain in DOMAINS:
        total = sum(width for gid, width in bars.items() if f"-{domain}-" in gid)
        assert total == pytest.approx(scores.by_domain[domain]["ivcs"].value, abs=1e-12)


def test_slopes_show_ranks_and_tell_every_change() -> None:
    figure = cached_drawings("18 cells", "domains")["domains_ranks"]
    found = ranking(Scores(tuple(CASES["18 cells"])).cells, "domain")
    assert gids(figure)["line"] == 3
    assert gids(figure)["label"] == 6
    assert found.changes
    changed = {change.subject for change in found.changes}
    scenarios = sorted(found.scenarios)
    names = ", ".join(map(words, scenarios))
    told = re.search(rf"Ranks that change between scenarios \({names}\): ([^.]*)\.", figure.caption)
    assert told is not None
    assert set(told[1].split("; ")) == {
        f"{one} {', '.join(str(found.scenarios[s][one]) for s in scenarios)}" for one in changed
    }
    for artist in figure.figure.findobj():
        if (artist.get_gid() or "").startswith("line-"):
            assert (artist.get_linestyle() == ":") == (artist.get_gid()[5:] not in changed)


def test_the_name_of_the_constants_line_hides_no_mark() -> None:
    rows = [*CASES["18 cells"], *rows_of(("best_constant",), seed=1)]
    rows = [replace(row, control=row.model == "best_constant") for row in rows]
    figure = drawings_of(rows, "models")["models_ranks"]
    named = [box for text, box, _ in texts_of(figure) if "best blind constant" in text]
    marks = [a for a in figure.figure.findobj() if (a.get_gid() or "").startswith("macro-")]
    renderer = figure.figure.canvas.get_renderer()
    assert len(named) == 1
    assert len(marks) == 3
    assert all(mark.get_window_extent(renderer).y0 > named[0][3] for mark in marks)


def constants(figure: Drawing) -> dict[str, list[float]]:
    """The lines of the best blind constant: their places on the axis by what they belong to."""
    return {
        artist.get_gid().removeprefix("constant-"): list(artist.get_xdata())
        for artist in figure.figure.findobj()
        if (artist.get_gid() or "").startswith("constant-")
    }


def test_the_best_constant_is_a_line_in_every_figure_of_ranks() -> None:
    rows = [*CASES["18 cells"], *rows_of(("best_constant",), seed=1)]
    rows = [replace(row, control=row.model == "best_constant") for row in rows]
    scores = Scores(tuple(rows))
    pages = [constants(one) for one in drawings_of(rows, "matrix").values()]
    assert sum(map(len, pages)) == len(rows) == 24
    values = {model: value for (model,), value in scores.constant("model").items()}
    assert set(values) == set(MODELS)
    drawings = {**drawings_of(rows, "models"), **drawings_of(rows, "foundation")}
    for name in ("models_range", "foundation_ranking"):
        assert constants(drawings[name]) == {
            model: pytest.approx([value, value]) for model, value in values.items()
        }
    assert len(constants(drawings["models_ranks"])) == 1
    assert set(constants(drawings_of(rows, "domains")["domains_ranks"])) == set(DOMAINS)


def test_the_axis_of_profiles_has_a_title() -> None:
    found = [
        text for text, _, _ in texts_of(cached_drawings("18 cells", "models")["models_profiles"])
    ]
    assert "mean score, from 0 to 1" in found


def grey(colour: str) -> float:
    """Lightness of a colour in print without colour, 0 to 1 (Rec. 601)."""
    red, green, blue = to_rgb(colour)
    return 0.299 * red + 0.587 * green + 0.114 * blue


def test_domains_are_told_apart_without_colour() -> None:
    """Markers distinguish the domains; lines without markers differ in lightness."""
    looks = [DOMAIN_LOOKS[domain] for domain in DOMAINS]
    assert len({look.marker for look in looks}) == 3
    for one, other in itertools.combinations(looks, 2):
        assert abs(grey(one.colour) - grey(other.colour)) > 0.15
    figures = cached_drawings("18 cells", "domains")
    for name, start in (("domains_components", "mean-"), ("domains_ranks", "line-")):
        markers = {
            artist.get_gid().rpartition("-")[2]: artist.get_marker()
            for artist in figures[name].figure.findobj()
            if (artist.get_gid() or "").startswith(start)
        }
        assert markers == {domain: DOMAIN_LOOKS[domain].marker for domain in DOMAINS}


def test_neighbouring_parts_of_ivcs_are_told_apart_without_colour() -> None:
    looks = [COMPONENT_LOOKS[key] for key in ivcs_weights()]
    for one, other in itertools.combinations(looks, 2):
        assert one.hatch != other.hatch or abs(grey(one.colour) - grey(other.colour)) > 0.15


@pytest.mark.parametrize(
    ("kind", "name"), [("domains", "domains_ranks"), ("models", "models_ranks")]
)
def test_slopes_mark_the_macro_average_of_each_line(kind: str, name: str) -> None:
    scores = Scores(tuple(CASES["18 cells"]))
    groups = scores.by_domain if kind == "domains" else scores.by_model
    figure = cached_drawings("18 cells", kind)[name]
    marks = {
        artist.get_gid().removeprefix("macro-"): (artist.get_xdata()[0], artist.get_ydata()[0])
        for artist in figure.figure.findobj()
        if (artist.get_gid() or "").startswith("macro-")
    }
    assert marks.keys() == groups.keys()
    assert len({x for x, _ in marks.values()}) == 1
    by_height = sorted(marks, key=lambda one: marks[one][1])
    by_score = sorted(groups, key=lambda one: -(groups[one]["ivcs"].value or 0.0))
    assert by_height == by_score  # y grows downwards
    for one, group in groups.items():
        assert f"{one} {group['ivcs'].value:.3f} (#" in figure.caption


def test_of_many_scenarios_the_caption_names_best_and_worst_ranks() -> None:
    scores = Scores(tuple(rows_of(scenarios=[f"scenario_{k}" for k in range(8)])))
    (figure,) = (one for one in models(scores, None) if one.name == "models_ranks")
    assert isinstance(figure, Drawing)
    found = ranking(scores.cells, "model")
    assert found.changes
    for one in {change.subject for change in found.changes}:
        ranks = [rank for s in found.scenarios.values() if (rank := s[one]) is not None]
        assert f"{one} {min(ranks)} to {max(ranks)}" in figure.caption


def test_models_have_a_mark_per_scenario_a_panel_and_a_difference() -> None:
    figures = cached_drawings("30 models", "models")
    assert gids(figures["models_range"])["scenario"] == 60
    assert gids(figures["models_range"])["macro"] == 30
    assert gids(figures["models_profiles"])["bar"] == 30 * 7
    assert gids(figures["models_difference"])["bar"] == 29 * 6
    assert gids(figures["models_ranks"])["line"] == 30


def test_differences_are_taken_over_what_both_models_have() -> None:
    rows = [row for row in rows_of() if (row.model, row.scenario) != ("alpamayo", "vru_crossing")]
    scores = Scores(tuple(rows))
    (figure,) = (one for one in models(scores, "openemma") if one.name == "models_difference")
    assert isinstance(figure, Drawing)
    bars = {
        artist.get_gid(): artist.get_width()
        for artist in figure.figure.findobj()
        if (artist.get_gid() or "").startswith("bar-")
    }
    mine, theirs = (
        [row.ivcs for row in rows if row.model == model and row.scenario == "cut_in"]
        for model in ("alpamayo", "openemma")
    )
    assert bars["bar-alpamayo-ivcs"] == pytest.approx((sum(mine) - sum(theirs)) / 3, abs=1e-12)
    assert "openemma (as chosen)" in figure.caption
    (ranks,) = (one for one in models(scores, None) if one.name == "models_ranks")
    assert isinstance(ranks, Drawing)
    assert "The models were not scored on the same cells" in ranks.caption
    assert ranks.caption.count("Cells: ") == 1
    (ranks,) = (one for one in domains(scores) if one.name == "domains_ranks")
    assert isinstance(ranks, Drawing)
    assert "not scored on the same cells" not in ranks.caption


def test_foundation_figures_show_only_what_is_known() -> None:
    rows = CASES["30 models"]
    scores = Scores(tuple(rows))
    figures = cached_drawings("30 models", "foundation")
    assert gids(figures["foundation_semantics_trajectory"])["point"] == 30
    assert gids(figures["foundation_parameters"])["point"] == 20
    unknown = {row.model for row in rows if row.active_b is None}
    assert all(model in figures["foundation_parameters"].caption for model in unknown)
    points = {
        model: (group["sem_acc_eff"].value or 0.0, group["tqsr"].value or 0.0)
        for model, group in scores.by_model.items()
    }
    caption = figures["foundation_semantics_trajectory"].caption
    assert ", ".join(pareto_front(points)) in caption
    assert gids(figures["foundation_architectures"])["end"] == 12
    assert gids(figures["foundation_ranking"])["bar"] == 30


def test_what_can_t_be_drawn_says_why() -> None:
    refused = [replace(row, status="refused", reason="x") for row in rows_of()]
    for kind, draw in KINDS.items():
        for one in draw(Scores(tuple(refused))):
            assert isinstance(one, Drawing if kind == "matrix" else LeftOut)
            assert kind == "matrix" or one.reason
    for draw in KINDS.values():
        assert all(isinstance(one, LeftOut) and one.reason for one in draw(Scores(())))
