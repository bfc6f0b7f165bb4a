"""Controls: each model beside its blinded self, on the recordings that both were scored on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ssp_eval.report.load import CellData
from ssp_eval.score.aggregate import Cell, mean

COLUMNS = {"sem_acc_eff": "SemAcc", "cia_eff": "CIA", "tqsr": "TQSR", "ivcs": "IVCS"}


@dataclass(frozen=True)
class BlindedRow:
    """One model and one condition.

    Args:
        model: name.
        condition: black or shuffled.
        n: recordings on which both were scored.
        seeing: means of COLUMNS of the model itself.
        blinded: of the same model under the condition.
    """

    model: str
    condition: str
    n: int
    seeing: Mapping[str, float | None]
    blinded: Mapping[str, float | None]

    @property
    def difference(self) -> float | None:
        """IVCS that is owed to seeing; None where no recording was scored with both."""
        seeing, blinded = self.seeing["ivcs"], self.blinded["ivcs"]
        return None if seeing is None or blinded is None else seeing - blinded


def blinded_rows(cells: Sequence[CellData]) -> list[BlindedRow]:
    """Every model that was asked under a condition, with every such condition."""
    seeing = {(c.model, c.scenario, c.domain): c for c in cells if not c.facts.condition}
    groups: dict[tuple[str, str], list[CellData]] = {}
    for cell in cells:
        if condition := cell.facts.condition:
            model = cell.model.removesuffix(f"+{condition}")
            groups.setdefault((model, condition), []).append(cell)
    rows = []
    for (model, condition), group in sorted(groups.items()):
        pairs = [
            (own, cell)
            for cell in group
            if (own := seeing.get((model, cell.scenario, cell.domain))) is not None
            and own.score is not None
            and cell.score is not None
        ]
        rows.append(
            BlindedRow(
                model,
                condition,
                len(pairs),
                _means([own for own, _ in pairs]),
                _means([cell for _, cell in pairs]),
            )
        )
    return rows


def _means(cells: Sequence[CellData]) -> dict[str, float | None]:
    return {
        key: mean(getattr(cell.score, key) for cell in cells if cell.score is not None).value
        for key in COLUMNS
    }


def control_cells(cells: Sequence[CellData]) -> list[Cell]:
    """The scored cells of the harness's own answerers."""
    return [
        Cell(c.scenario, c.domain, c.model, c.score.to_json(), True)
        for c in cells
        if c.score is not None and c.is_control and not c.facts.condition
    ]
