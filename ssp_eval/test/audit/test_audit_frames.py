"""The frame that stands for an instant, and the caption that the page gives it."""

from __future__ import annotations

import math
import re
from pathlib import Path

import jinja2
from hypothesis import given
from hypothesis import strategies as st

from ssp_eval.audit import page
from ssp_eval.audit import page as frames
from ssp_eval.audit.page import frame_at

AT_12_HZ = [k / 12.0 for k in range(108)]


def test_a_rounded_time_finds_its_own_frame() -> None:
    assert [frame_at(AT_12_HZ, round(t_s, 3)) for t_s in AT_12_HZ] == [*range(108)]


@given(st.sampled_from([8.0, 10.0, 12.0, 29.97, 50.0]), st.floats(0.0, 2.0))
def test_a_frame_is_at_most_half_a_frame_from_the_newest(rate_hz: float, t_s: float) -> None:
    times = [k / rate_hz for k in range(math.ceil(3.0 * rate_hz))]
    shown = times[frame_at(times, t_s)]
    assert abs(shown - t_s) <= 0.5 / rate_hz + 2e-6


def test_across_a_gap_the_old_frame_stays() -> None:
    times = [0.0, 0.1, 0.2, 0.9, 1.0, 1.1]
    assert frame_at(times, 0.8) == 2
    assert frame_at(times, 0.87) == 3
    assert (frame_at([0.4], 0.0), frame_at([0.4], 9.0), frame_at(times, -1.0)) == (0, 0, 0)


def test_a_caption_tells_the_instant_from_the_frame() -> None:
    source = (Path(page.__file__).parent / "page.html.j2").read_text()
    caption = re.search(r"<figcaption>(.*?)</figcaption>", source)
    assert caption is not None
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined)
    given = {
        "picture": frames.Picture("trigger", at_s=3.208, phi=0.35644, t_s=3.1667),
        "r": {"domain": "synthetic"},
    }
    text = re.sub("<.*?>", "", environment.from_string(caption[1]).render(given))
    assert text == "3.208 s · φ 0.356 · frame 3.167 s, synthetic, trigger"


def test_tables_of_three_recordings_are_stacked_on_a_narrow_screen() -> None:
    here = Path(page.__file__).parent
    source = (here / "page.html.j2").read_text()
    tables = re.findall(r'(<div class="scroll">)?<table class="compare">', source)
    assert len(tables) == source.count("</tbody></table></div>") == 7
    assert all(tables)
    narrow = (here / "style.css").read_text().split("@media (max-width: 900px)")[1]
    assert ".compare tr { display: flex; flex-wrap: wrap;" in narrow
    assert "overflow-x: auto" not in narrow


def test_every_drawing_of_the_pages_has_a_title_or_is_hidden_from_screen_readers() -> None:
    root = Path(page.__file__).parents[1]
    drawings = [
        found
        for file in sorted(root.rglob("*.j2"))
        for found in re.findall(r"<svg [^>]*>(?:<title>)?", file.read_text("utf-8"))
    ]
    assert len(drawings) >= 4
    for drawing in drawings:
        assert 'aria-hidden="true"' in drawing or (
            'role="img"' in drawing and "aria-label=" in drawing and drawing.endswith("<title>")
        ), drawing
