"""Synthetic source clips: what whoever binds a K* to one asks of whoever draws it.

The two sides never import each other: who needs a clip loads the drawing side by its module
(``clip_maker``).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, cast

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.road import Road

CLIP_MODULE = "ssp_ot_controller.camera.clip"


class ClipBoard(Protocol):
    """A whole clip before it is drawn; map and block frame are the same."""

    @property
    def scenario(self) -> str:
        """Kind of interaction that it shows."""

    @property
    def seed(self) -> int:
        """Of speeds, timing and light."""

    @property
    def road(self) -> Road:
        """That it takes place on."""

    @property
    def fps(self) -> float:
        """Frames a second."""

    @property
    def duration_s(self) -> float:
        """Length of the clip."""

    def times(self) -> list[float]:
        """Times of the frames in s, from 0."""

    def states(self, t_s: float) -> Sequence[ObjectState]:
        """All objects at a time, the VUT too."""


class ClipMaker(Protocol):
    """The module that draws clips."""

    GENERATOR: str

    def board_of(self, kind: str, seed: int, same: int, opposite: int) -> ClipBoard:
        """A clip of a kind on a road with so many lanes with and against the VUT."""

    def truth_path(self, video: Path) -> Path:
        """Where the ground truth of a clip stands."""

    def write_clip(self, board: ClipBoard, video: Path, advance: Callable[[], None]) -> None:
        """Draws a clip into a file, and writes its ground truth beside it."""


def clip_maker(module: str = CLIP_MODULE) -> ClipMaker:
    """The drawing side, by its module.

    Raises:
        ImportError: it isn't installed.
    """
    return cast(ClipMaker, importlib.import_module(module))
