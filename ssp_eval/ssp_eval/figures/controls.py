"""What checks of the harness show: each model with spoilt frames, and answerers without eyes."""

from __future__ import annotations

from collections.abc import Mapping

from ssp_eval.analysis.control_tables import ANSWERERS, SEEING, control_tables
from ssp_eval.analysis.table import Table, Value
from ssp_eval.evaluate.controls import BLACK, SHUFFLED
from ssp_eval.figures.drawing import Drawing, LeftOut, caption, page_name, renamed
from ssp_eval.figures.named_rows import ROW_IN, named_rows, row_pages
from ssp_eval.figures.scores import Scores
from ssp_eval.figures.style import (
    BLUE,
    GREY,
    INK,
    NAMES_IN,
    ORANGE,
    Look,
    names_in,
    row_width_in,
    share_axis,
)
from ssp_eval.score.aggregate import Mean

NAME = "controls"
_SPOILT = {BLACK: "black frames", SHUFFLED: "shuffled frames"}
_OWN, _OTHER, _CONTROL = Look(BLUE, "o", ""), Look(ORANGE, "s", ""), Look("#bdbdbd", "D", "")


def controls(scores: Scores) -> list[Drawing | LeftOut]:
    """Mean IVCS of each model beside itself with spoilt frames, and of the other controls."""
    tables = {table.name: table for table in control_tables(scores.rows)}
    lines: dict[str, tuple[float | None, float]] = {}
    counts: dict[str, int] = {}
    for row in _named(tables.get(SEEING)):
        own, spoilt = _value(row["ivcs"]), _value(row["ivcs_spoilt"])
        if own is not None and spoilt is not None:
            name = f"{row['model']}: {_SPOILT[str(row['condition'])]}"
            lines[name], counts[name] = (own, spoilt), int(str(row["n"]))
    for row in _named(tables.get(ANSWERERS)):
        value = _value(row["ivcs"])
        if value is not None:
            lines[str(row["model"])], counts[str(row["model"])] = (None, value), int(str(row["n"]))
    if not lines:
        return [LeftOut(NAME, "there are no scored cells of controls")]
    pages = row_pages(list(lines))
    return [
        _page(page_name(NAME, number, len(pages)), {m: lines[m] for m in members}, counts)
        for number, members in enumerate(pages, start=1)
    ]


def _page(
    name: str, lines: Mapping[str, tuple[float | None, float]], counts: Mapping[str, int]
) -> Drawing:
    width_in = row_width_in(lines)
    names = names_in(lines, NAMES_IN[width_in])
    seeing = any(own is not None for own, _ in lines.values())
    legend = {"as it is": _OWN, "spoilt frames": _OTHER} if seeing else {}
    if any(own is None for own, _ in lines.values()):
        legend["answerer of the harness"] = _CONTROL
    sheet, axes, head_in = named_rows(width_in, list(names.values()), legend, right_in=0.45)
    for row, (label, (own, value)) in enumerate(lines.items()):
        if own is not None:
            axes.plot([own, value], [row, row], color=GREY, linewidth=1.2, zorder=2)
        marks = ((own, _OWN, 7.5), (value, _CONTROL if own is None else _OTHER, 4.5))
        for x, look, size in marks:
            if x is not None:
                # The larger one is seen behind the other where nothing changed.
                axes.plot(
                    [x], [row], look.marker, color=look.colour, markeredgecolor=INK,
                    markeredgewidth=0.4, markersize=size, clip_on=False, zorder=3,
                    gid=f"control-{label}",
                )  # fmt: skip
        text = f"{value:.2f}" if own is None else f"{value - own:+z.2f}".replace("-", "−")
        sheet.figure.text(
            1.0 - 0.05 / width_in, 1.0 - (head_in + ROW_IN * (row + 0.5)) / sheet.height_in, text,
            va="center_baseline", ha="right", color=GREY,
        )  # fmt: skip
    share_axis(axes, "IVCS, mean over cells")
    told = ", ".join(f"{label} {counts[label]}" for label in lines)
    return Drawing(
        name,
        sheet.figure,
        caption(
            "Controls, which enter no mean elsewhere. A model's IVCS as it is and with spoilt "
            "frames, everything else in the question being the same: means over the recordings "
            "scored with both, at the right the change. Who scores as much without seeing isn't "
            "scored for what it sees."
            if seeing
            else "Controls, which enter no mean elsewhere.",
            "Answerers of the harness, at the right their IVCS: perfect should have 1, silent 0, "
            "and constant_velocity and copy_history see no frame."
            if len(legend) != 2
            else "",
            f"Cells: {told}.",
            renamed(names),
        ),
    )


def _named(table: Table | None) -> list[dict[str, Value]]:
    if table is None:
        return []
    keys = [column.key for column in table.columns]
    return [dict(zip(keys, row, strict=True)) for row in table.rows]


def _value(value: Value) -> float | None:
    return value.value if isinstance(value, Mean) else None
