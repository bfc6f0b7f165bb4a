"""Phase-aligned frames of the domains with plans and actions on them (METHOD 7.5)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from ssp_core.files.folders import make_folder
from ssp_core.vocabulary import DOMAINS, PHASES
from ssp_eval.evaluate.store.results import CellData
from ssp_eval.figures.moments import RIGHT, WRONG, CellMoments, Moment, cell_moments
from ssp_eval.figures.scores import words
from ssp_eval.figures.style import (
    COLUMN_IN,
    GREY,
    INK,
    ORANGE,
    PAGE_IN,
    SKY,
    Drawing,
    Sheet,
    caption,
    fitted,
    text_width_in,
)
from ssp_eval.figures.write import FiguresOutcome, written_drawings
from ssp_eval.score.cli import NULL
from ssp_eval.statistics.rows import rows_from_cells
from ssp_eval.statistics.tables.notices import caption_text

_LEFT_IN, _GAP_IN, _HEAD_IN, _FOOT_IN = 0.22, 0.06, 0.22, 0.24
_LINE_IN = 0.125
_TEXT_IN = 4 * _LINE_IN + 0.09
_DPI = 300


def phase_frames(scenario: str, model: str, stories: Sequence[CellMoments]) -> Drawing:
    """Return the frames of one scenario and model: a row per domain, a column per phase."""
    by_domain = {story.cell.domain: story for story in stories}
    width_in = (PAGE_IN - _LEFT_IN - 0.05 - _GAP_IN * (len(PHASES) - 1)) / len(PHASES)
    shape = max((_aspect(story) for story in stories), default=9 / 16)
    height_in = width_in * shape
    row_in = height_in + _TEXT_IN
    phases = [p for p in PHASES if any(_first(story, p) is not None for story in stories)]
    room_in = _LEFT_IN + len(phases) * (width_in + _GAP_IN)
    sheet_in = max(COLUMN_IN, room_in)
    foot_in = _FOOT_IN + _LINE_IN * (_legend_lines(sheet_in) - 1)
    sheet = Sheet(sheet_in, _HEAD_IN + row_in * len(DOMAINS) + foot_in)
    page = sheet.page()
    page.set_zorder(3)
    for column, phase in enumerate(phases):
        left = _LEFT_IN + column * (width_in + _GAP_IN)
        page.text(left + width_in / 2, 0.14, phase, ha="center", weight="bold")
    for row, domain in enumerate(DOMAINS):
        top = _HEAD_IN + row * row_in
        page.text(
            0.1, top + height_in / 2, domain, rotation=90, ha="center", va="center", weight="bold"
        )
        story = by_domain.get(domain)
        for column, phase in enumerate(phases):
            left = _LEFT_IN + column * (width_in + _GAP_IN)
            axes = sheet.axes(left, top, width_in, height_in)
            axes.set_axis_off()
            moment = None if story is None else _first(story, phase)
            if story is None or moment is None:
                why = "no scores" if story is None else "no label in this phase"
                page.text(
                    left + width_in / 2,
                    top + height_in / 2,
                    why,
                    ha="center",
                    va="center",
                    color=GREY,
                )
                continue
            _panel(axes, story, moment, width_in, f"{domain}-{phase}")
            clock = f"{moment.label.t_s:.2f} s"
            page.text(
                left + 0.04,
                top + 0.09,
                clock,
                va="center_baseline",
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.2},
            )
            allowed = _wrapped(f"ok: {moment.allowed}", width_in)
            lines = (f"says {moment.says}", f"plans {moment.plans}", *allowed)
            for number, line in enumerate(lines):
                page.text(
                    left,
                    top + height_in + 0.06 + _LINE_IN * (number + 0.5),
                    fitted(line, width_in),
                    va="center",
                    color=INK if number < 2 else GREY,
                )
    _legend(page, sheet)
    return Drawing(
        f"phases_{scenario}_{model}", sheet.figure, _caption(scenario, model, by_domain, phases)
    )


def _wrapped(text: str, width_in: float) -> list[str]:
    """Return text in two lines at most, broken at spaces; what is left stays on the second."""
    first, rest = text.split(" "), list[str]()
    while len(first) > 1 and text_width_in(" ".join(first)) > width_in:
        rest.insert(0, first.pop())
    return [" ".join(first), " ".join(rest)]


def _aspect(story: CellMoments) -> float:
    geometry = story.cell.facts.clip.geometry
    return 9 / 16 if geometry is None else geometry.height_px / geometry.width_px


def _first(story: CellMoments, phase: str) -> Moment | None:
    """Return the first moment of a phase of which there is a frame."""
    return next((m for m in story.moments if m.label.phase == phase and m.frames), None)


def _panel(axes: Axes, story: CellMoments, moment: Moment, width_in: float, gid: str) -> None:
    image = story.picture(moment.frames[-1][1])
    height_px, width_px = image.shape[:2]
    small_px = min(width_px, round(width_in * _DPI))
    size = (small_px, max(1, round(height_px * small_px / width_px)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    axes.imshow(
        cv2.cvtColor(small, cv2.COLOR_BGR2RGB), extent=(-0.5, width_px - 0.5, height_px - 0.5, -0.5)
    )
    axes.set_xlim(-0.5, width_px - 0.5)
    axes.set_ylim(height_px - 0.5, -0.5)
    if moment.stamp_ns is not None:
        driven = story.ribbon_of(story.recorded(moment.stamp_ns))
        if driven is not None and len(driven.middle) > 1:
            for colour, width in ((INK, 2.4), (ORANGE, 1.4)):
                axes.plot(
                    *zip(*driven.middle, strict=True),
                    "--",
                    color=colour,
                    linewidth=width,
                    zorder=4,
                    gid=f"recorded-{gid}" if colour == ORANGE else None,
                )
    plan = story.ribbon_of(moment.plan)
    if plan is not None:
        surface = Polygon(
            plan.outline, facecolor=SKY, alpha=0.45, edgecolor="white", linewidth=0.8, zorder=2
        )
        surface.set_gid(f"plan-{gid}")
        axes.add_patch(surface)
        if plan.dots:
            axes.plot(
                *zip(*plan.dots, strict=True),
                "o",
                color="white",
                markeredgecolor=INK,
                markersize=2.6,
                markeredgewidth=0.5,
                zorder=5,
            )


_ENTRIES = (
    "plan, a dot every 0.5 s",
    "recorded path",
    f"{RIGHT} allowed   {WRONG} not allowed   {NULL} not said",
)


def _legend_lines(width_in: float) -> int:
    """Return one line, or two where the words about actions need one of their own."""
    needed = _LEFT_IN + 1.25 + sum(text_width_in(entry) for entry in _ENTRIES)
    return 1 if needed <= width_in else 2


def _legend(page: Axes, sheet: Sheet) -> None:
    lines = _legend_lines(sheet.width_in)
    y = sheet.height_in - 0.1 - _LINE_IN * (lines - 1)
    x = _LEFT_IN
    corners = [(x, y + 0.04), (x + 0.25, y + 0.04), (x + 0.2, y - 0.05), (x + 0.05, y - 0.05)]
    page.add_patch(Polygon(corners, facecolor=SKY, edgecolor=GREY, linewidth=0.5))
    x += 0.32
    page.text(x, y, _ENTRIES[0], va="center")
    x += text_width_in(_ENTRIES[0]) + 0.25
    for colour, width in ((INK, 2.4), (ORANGE, 1.4)):
        page.plot([x, x + 0.3], [y, y], "--", color=colour, linewidth=width)
    x += 0.37
    page.text(x, y, _ENTRIES[1], va="center")
    x += text_width_in(_ENTRIES[1]) + 0.25
    if lines == 1:
        page.text(x, y, _ENTRIES[2], va="center")
    else:
        page.text(_LEFT_IN, y + _LINE_IN, _ENTRIES[2], va="center")


def _caption(
    scenario: str, model: str, by_domain: dict[str, CellMoments], phases: Sequence[str]
) -> str:
    missing = [domain for domain in DOMAINS if domain not in by_domain]
    blind = [domain for domain, story in by_domain.items() if not story.sees_ground]
    ego = [f"{domain} {story.ego_provenance}" for domain, story in by_domain.items()]
    counts = [f"{domain} {len(story.moments)}" for domain, story in by_domain.items()]
    return caption(
        f"{words(scenario)}, {model}: the first frame with a label in each phase, by domain. The "
        "ribbon is what the VUT would cover on the predicted trajectory, a dot every 0.5 s; the "
        f"dashed line is the path that was driven, as far as later requests tell it "
        f"(motion of the VUT: {', '.join(ego)}). Both were drawn after the fact and were in no "
        "input of a model.",
        "Below a frame: clip time, the actions that the text commits to and those that the "
        "trajectory makes, longitudinal and lateral, each pair marked as allowed or not, and after "
        "ok what is allowed; – is an action that isn't said, and never allowed.",
        f"Labels: {', '.join(counts)}; n = 1 answer per frame.",
        f"No label falls in: {', '.join(p for p in PHASES if p not in phases)}."
        if len(phases) < len(PHASES)
        else "",
        f"Without scores: {', '.join(missing)}." if missing else "",
        f"Without a known pose of the camera, and so without paths: {', '.join(blind)}."
        if blind
        else "",
        caption_text(rows_from_cells([story.cell for story in by_domain.values()])),
    )


# Frames of more cells take minutes, and are drawn when they are asked for by name.
MOST_CELLS = 24


def write_phase_frames(
    campaign: Path,
    out: Path,
    cells: Sequence[CellData],
    progress: Callable[[str], None] = lambda _name: None,
    limit: bool = False,
) -> FiguresOutcome:
    """Write the phase-aligned frames of each scenario and model; controls show no model.

    Args:
        campaign: folder with the frames.
        out: folder of the figures.
        cells: of the campaign, controls included.
        progress: called with a figure's name once it is written.
        limit: leave them all out where they are of more than MOST_CELLS cells.

    Raises:
        InputError: a frame isn't as the campaign left it, or the folder can't be written.
    """
    stories = [cell_moments(cell, campaign) for cell in cells if not cell.is_control]
    groups: dict[tuple[str, str], list[CellMoments]] = {}
    for story in (one for one in stories if one is not None):
        groups.setdefault((story.cell.scenario, story.cell.model), []).append(story)
    count = sum(map(len, groups.values()))
    if limit and count > MOST_CELLS:
        why = f"{count} cells take minutes; ask for them with --only phases"
        return FiguresOutcome((), (("phases", why),))
    make_folder(out)
    drawings = (phase_frames(*key, members) for key, members in sorted(groups.items()))
    return written_drawings(drawings, out, progress)
