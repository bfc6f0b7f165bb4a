"""Contact sheets: every frame is there, in order, whole, and large enough."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.video import Image, Tile, contact_sheet


def grey(level: int, width: int = 64, height: int = 36) -> Image:
    return np.full((height, width, 3), level, np.uint8)


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.integers(10, 200), min_size=1, max_size=9),
    st.integers(1, 4),
    st.sampled_from([32, 64, 160]),
)
def test_tiles_stand_in_rows_and_keep_their_pixels(
    levels: list[int], columns: int, width: int
) -> None:
    sheet = contact_sheet([Tile(grey(level), ("one", "two")) for level in levels], columns, width)
    across = min(columns, len(levels))
    height = 44 + round(36 * width / 64)
    rows = -(-len(levels) // across)
    assert sheet.shape == (rows * (height + 8) + 8, across * (width + 8) + 8, 3)
    for i, level in enumerate(levels):
        left, top = 8 + (i % across) * (width + 8), 8 + (i // across) * (height + 8) + 44
        frame = sheet[top : top + height - 44, left : left + width]
        assert np.all(frame == level)


def test_a_row_is_as_high_as_its_highest_tile() -> None:
    tiles = [Tile(grey(50, 64, 20), ("x",)), Tile(grey(90, 64, 64), ("x",)), Tile(grey(7), ("x",))]
    sheet = contact_sheet(tiles, 2, 64)
    assert sheet.shape[0] == 8 + (22 + 64) + 8 + (22 + 36) + 8
    assert np.all(sheet[8 + 86 + 8 + 22 : -8, 8:72] == 7)


def test_a_long_line_is_made_to_fit() -> None:
    sheet = contact_sheet([Tile(grey(50), ("a word and a word " * 5 + "…",))], 1, 200)
    head = sheet[8:30, 8:208]
    dark = np.argwhere(head.min(axis=2) < 128)
    assert len(dark)
    assert dark[:, 1].max() < 200
    assert np.all(sheet[8:30, 208:] == 250)
