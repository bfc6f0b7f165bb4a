"""The table of responses: did the VUT respond alike in the recordings that a campaign is made of?

It is what the campaign's audits say (docs/audit.md); it enters no score and no statistics.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from ssp_core.errors import InputError
from ssp_eval.data.audit import Audit, load_audit
from ssp_eval.data.response import PairEntry
from ssp_eval.evaluate.store.admission import audit_files
from ssp_eval.evaluate.store.results import CellFacts
from ssp_eval.statistics.table import Column, Table, Value

_PARTS = ("overall", "corridor", "phase", "magnitude", "slope")
_FIGURES = {
    "ttc_at_braking": "Δ TTC at braking (s)",
    "remaining_distance": "Δ remaining distance (m)",
    "impact_speed": "Δ impact speed (m/s)",
}
_COLUMNS = (
    *(Column(key, key, "text") for key in ("scenario", "comparison", "reference", "verdict")),
    *(Column(key, "ISO 18571" if key == "overall" else key) for key in _PARTS),
    *(Column(key, title, "signed") for key, title in _FIGURES.items()),
    Column("delay", "delay (s)", "signed"),
    Column("gain", "gain", "decimal"),
    Column("why", "why", "text"),
)
_NOTES = (
    "From the transfer audits; each difference is comparison minus reference. This qualifies no "
    "event and scores no model.",
    "ISO 18571: rating of the VUT's longitudinal acceleration by ISO/TS 18571, aligned at its "
    "braking. delay: on time since the trigger; gain: of the deceleration as it builds up.",
)


def named_audits(folders: Sequence[Path], cells: Iterable[CellFacts]) -> list[Audit]:
    """Return the audits that cells go by, of those that lie in their campaigns' folders.

    One that can't be read is left out: its cells say so.
    """
    files = {digest: file for folder in folders for digest, file in audit_files(folder).items()}
    audits = []
    for digest in dict.fromkeys(cell.admission.audit_sha256 for cell in cells):
        if digest is not None and digest in files:
            with suppress(InputError):
                audits.append(load_audit(files[digest]))
    return audits


def response_table(audits: Iterable[Audit]) -> Table | None:
    """Return a row for each pair of recordings; None where no audit has one."""
    rows = [
        _row(audit.scenario, pair)
        for audit in audits
        if audit.response is not None
        for pair in audit.response.pairs
    ]
    if not rows:
        return None
    return Table("responses", "The same response", _COLUMNS, tuple(rows), _NOTES)


def _row(scenario: str, pair: PairEntry) -> tuple[Value, ...]:
    figures = {figure.name: figure.difference for figure in pair.figures}
    causes = {cause.name: cause.value for cause in pair.causes}
    return (
        scenario,
        pair.comparison,
        pair.reference,
        pair.verdict,
        *(None if pair.rating is None else getattr(pair.rating, part) for part in _PARTS),
        *(figures.get(name) for name in ("ttc_at_braking", "remaining_distance", "impact_speed")),
        causes.get("delay"),
        causes.get("gain"),
        "; ".join(pair.why),
    )
