"""The picture of the native frames shows what the adapters give."""

from __future__ import annotations

import importlib.util
import math
import sys
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).resolve().parent.parent / "docs"


@pytest.fixture(scope="module")
def drawing() -> ModuleType:
    spec = importlib.util.spec_from_file_location("docs_frames", DOCS / "native_frames.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up there
    spec.loader.exec_module(module)
    return module


def test_the_picture_is_up_to_date(drawing: ModuleType) -> None:
    written = (DOCS / "images" / "native-frames.svg").read_text()
    assert written == drawing.draw(), "run `python docs/native_frames.py`"
    assert "images/native-frames.svg" in (DOCS / "native-frames.md").read_text()


def test_one_turn_written_in_each_frame_is_one_turn_in_ours(drawing: ModuleType) -> None:
    for panel in drawing.panels():
        assert panel.points[0] == (0.0, 0.0)
        for x_m, y_m in panel.points:
            # On the circle to the left, up to the two decimals of a written point.
            assert math.hypot(x_m, y_m - drawing.RADIUS_M) == pytest.approx(
                drawing.RADIUS_M, abs=0.01
            )
        assert panel.points[-1] == pytest.approx(drawing.panels()[0].points[-1], abs=0.01)
