"""The table of labels: what each recording asks for, and how large its critical object is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ssp_eval.data.audit import HARDLY_VISIBLE_PX, Audit, LabelCount, LabelSize
from ssp_eval.evaluate.store.results import CellData
from ssp_eval.statistics.table import Column, Table, Value

LABELS_TABLE = "labels"
HARDLY_VISIBLE = "hardly visible"
_SAME_S = 1e-6


def label_table(cells: Iterable[CellData], audits: Sequence[Audit]) -> Table:
    """Return every label of every scored recording.

    Args:
        cells: of the campaign.
        audits: those that the cells go by; they know the size of the critical object.
    """
    sizes = {r.bag_sha256: r.labels for audit in audits for r in audit.recordings}
    recordings: dict[tuple[str, str], CellData] = {}
    for cell in cells:
        if cell.score is not None:
            recordings.setdefault((cell.scenario, cell.domain), cell)
    rows: list[tuple[Value, ...]] = []
    lacking = []
    for (scenario, domain), cell in recordings.items():
        counted = sizes.get(cell.facts.hashes.get("bag") or "")
        sizes_by_time = _by_time(counted)
        for label in cell.labels.labels:
            size = sizes_by_time.get(round(label.t_s, 6))
            height_px = None if size is None else size.height_px
            mark = HARDLY_VISIBLE if size is not None and size.hardly_visible else ""
            rows.append(
                (
                    scenario,
                    domain,
                    label.t_s,
                    label.phase,
                    _words(label.objects),
                    label.position,
                    label.motion,
                    label.conflict,
                    _words(label.lon_actions),
                    _words(label.lat_actions),
                    height_px,
                    mark,
                )
            )
        if all(one.height_px is None for one in sizes_by_time.values()):
            why = (counted.sizes_from if counted is not None else "") or "not in its audit"
            lacking.append(f"{scenario} / {domain} ({why.removeprefix('not known: ')})")
    notes = [
        "height: of the part of the critical object's box that the recorded picture shows at the "
        "label's time, in px, as the audit projected it; 0: nothing of it. Labels under "
        f"{HARDLY_VISIBLE_PX:g} px are {HARDLY_VISIBLE}: no model can be expected to see it there.",
        *([f"Heights not known: {'; '.join(lacking)}."] if lacking else []),
    ]
    texts = ("objects", "position", "motion", "conflict", "longitudinal", "lateral")
    return Table(
        LABELS_TABLE,
        "Labels, and the size of the critical object in the picture",
        (
            Column("scenario", "scenario", "text"),
            Column("domain", "domain", "text"),
            Column("t_s", "t (s)", "seconds"),
            Column("phase", "phase", "text"),
            *(Column(key, key, "text") for key in texts),
            Column("height_px", "height (px)", "decimal"),
            Column("visibility", "visibility", "text"),
        ),
        tuple(rows),
        tuple(notes),
    )


def _by_time(counted: LabelCount | None) -> dict[float, LabelSize]:
    return {} if counted is None else {round(one.t_s, 6): one for one in counted.sizes}


def _words(words: Sequence[str] | None) -> str | None:
    return None if words is None else ", ".join(words)
