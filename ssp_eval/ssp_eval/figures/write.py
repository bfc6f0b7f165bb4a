"""Writes the figures of METHOD 7.1 to 7.4: SVG, PDF and PNG each, with a caption beside them."""

from __future__ import annotations

import io
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_bytes, write_text
from ssp_eval.figures.scores import Scores
from ssp_eval.statistics.rows import CellRow
from ssp_eval.statistics.tables.notices import caption_text

if TYPE_CHECKING:
    from ssp_eval.figures.style import Drawing, LeftOut

GROUPS = ("matrix", "domains", "models", "foundation")
DPI = 300
# No date and no version in a file: the same rows give the same bytes.
_METADATA: dict[str, dict[str, str | None]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}


@dataclass(frozen=True)
class FiguresOutcome:
    """The outcome of writing the figures.

    Args:
        left_out: name of a figure, and why these rows don't give it.
    """

    files: tuple[Path, ...]
    left_out: tuple[tuple[str, str], ...]


def write_figures(
    rows: Iterable[CellRow],
    out: Path,
    reference: str | None = None,
    only: Collection[str] = (),
    progress: Callable[[str], None] = lambda _name: None,
) -> FiguresOutcome:
    """Write every figure that the rows give.

    Args:
        rows: of a campaign or a file of component scores; their order doesn't matter.
        out: folder of the figures.
        reference: the model that others are compared to; None: the best by IVCS.
        only: groups (GROUPS) that are wanted; empty: all.
        progress: called with a figure's name once it is written.

    Raises:
        InputError: the reference is no model that enters means, or the folder can't be written.
    """
    scores = Scores(tuple(rows))
    if reference is not None and reference not in scores.by_model:
        raise InputError(
            "is no model with scores of its own",
            field="--reference",
            value=reference,
            remedy=f"name one of {', '.join(scores.by_model) or 'none, since there is no score'}",
        )
    make_folder(out)
    ending = caption_text(scores.rows)
    return written_drawings(_drawings(scores, reference, only), out, progress, ending)


def _drawings(
    scores: Scores, reference: str | None, only: Collection[str]
) -> Iterator[Drawing | LeftOut]:
    from ssp_eval.figures.domains import domains
    from ssp_eval.figures.foundation import foundation
    from ssp_eval.figures.matrix import matrix
    from ssp_eval.figures.models import models

    groups = only or GROUPS
    if "matrix" in groups:
        yield from matrix(scores, whole="matrix" in only)
    if "domains" in groups:
        yield from domains(scores)
    if "models" in groups:
        yield from models(scores, reference)
    if "foundation" in groups:
        yield from foundation(scores)


def written_drawings(
    drawings: Iterable[Drawing | LeftOut],
    out: Path,
    progress: Callable[[str], None],
    ending: str = "",
) -> FiguresOutcome:
    """Write drawings one by one, so that only one is in memory.

    Args:
        drawings: and what can't be drawn.
        out: folder of the files, which exists.
        progress: called with a figure's name once it is written.
        ending: sentence that ends each caption; empty: none.
    """
    from ssp_eval.figures.style import LeftOut, drawing

    files: list[Path] = []
    left_out: list[tuple[str, str]] = []
    with drawing():
        for item in drawings:
            if isinstance(item, LeftOut):
                left_out.append((item.name, item.reason))
                continue
            for kind, metadata in _METADATA.items():
                stream = io.BytesIO()
                title = {"Title": item.title}
                item.figure.savefig(stream, format=kind, dpi=DPI, metadata=metadata | title)
                files.append(out / f"{item.name}.{kind}")
                data = stream.getvalue()
                if kind == "svg":  # so that a screen reader takes it for one picture
                    data = data.replace(b"<svg ", b'<svg role="img" ', 1)
                write_bytes(files[-1], data)
            files.append(out / f"{item.name}.txt")
            write_text(files[-1], f"{item.caption.rstrip()} {ending}".rstrip() + "\n")
            progress(item.name)
    return FiguresOutcome(tuple(files), tuple(left_out))
