"""Controls as tables: what seeing is worth to each model, and what answerers without eyes get."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ssp_eval.analysis.row import OK, CellRow, merged, one_scale
from ssp_eval.analysis.table import Column, Table, Value
from ssp_eval.analysis.table_columns import COUNT, MEANS, TITLES
from ssp_eval.evaluate.controls import CONDITIONS
from ssp_eval.score.aggregate import BY_MODEL, Mean, mean, means

SEEING, ANSWERERS = "seeing", "answerers"
COMPARED = ("sem_acc_eff", "cia_eff", "tqsr", "ivcs")
DIFFERENCE = "ivcs_difference"
FINDING = "finding"
AS_MUCH = "scores as much without seeing"
UNPAIRED = "no recording was scored with both"


def condition_of(model: str) -> tuple[str, str]:
    """Name of the model and condition under which it was asked; empty where there is none."""
    name, _, last = model.rpartition("+")
    return (name, last) if name and last in CONDITIONS else (model, "")


def control_tables(rows: Sequence[CellRow]) -> list[Table]:
    """The tables of the controls that there are, none where there are none."""
    rows = one_scale(rows)
    scored = merged([row for row in rows if row.status == OK])
    asked = {row.model for row in rows if row.control and condition_of(row.model)[1]}
    blind = [row for row in scored if row.control and not condition_of(row.model)[1]]
    found = []
    if asked:
        found.append(seeing_table(scored, sorted(asked)))
    if blind:
        found.append(answerers_table(blind))
    return found


def seeing_table(rows: Sequence[CellRow], asked: Iterable[str]) -> Table:
    """Each model beside itself under a condition, on the recordings scored with both.

    Args:
        rows: valid ones, one per cell.
        asked: names of models with a condition.
    """
    known = {row.key: row for row in rows}
    table_rows = []
    for name in asked:
        model, condition = condition_of(name)
        pairs = [
            (own, row)
            for row in rows
            if row.model == name and (own := known.get((row.scenario, row.domain, model)))
        ]
        table_rows.append(_seeing_row(model, condition, pairs))
    columns = (
        Column("model", "model", "text"),
        Column("condition", "shown", "text"),
        COUNT,
        *(
            column
            for key in COMPARED
            for column in (
                Column(key, TITLES[key]),
                Column(f"{key}_spoilt", f"{TITLES[key]}, spoilt"),
            )
        ),
        Column(DIFFERENCE, "IVCS owed to seeing", "signed"),
        Column(FINDING, "finding", "text"),
    )
    return Table(
        SEEING,
        "What seeing is worth: each model beside itself with spoilt frames",
        columns,
        tuple(table_rows),
        (
            "Means over the recordings that were scored with both; n counts them. black: all "
            "frames black; shuffled: frames of other times. Everything else in a question stays.",
            "A model that scores as much with spoilt frames is not scored for what it sees: its "
            "answers come from its ego history, its prompt or its habits.",
        ),
    )


def _seeing_row(
    model: str, condition: str, pairs: Sequence[tuple[CellRow, CellRow]]
) -> tuple[Value, ...]:
    values: list[Mean] = [
        mean(getattr(pair[side], key) for pair in pairs) for key in COMPARED for side in (0, 1)
    ]
    # Of the two means rather than the mean difference: IVCS is never null, so they are the same.
    own, spoilt = (one.value for one in values[-2:])
    difference = None if own is None or spoilt is None else own - spoilt
    finding = UNPAIRED if difference is None else AS_MUCH if difference <= 0 else ""
    return model, condition, len(pairs), *values, difference, finding


def answerers_table(rows: Sequence[CellRow]) -> Table:
    """Means of the harness's own answerers.

    Args:
        rows: of controls without a condition; valid ones, one per cell.
    """
    found = means([row.cell() for row in rows], BY_MODEL)
    return Table(
        ANSWERERS,
        "The harness's own answerers",
        (Column("model", "control", "text"), COUNT, *MEANS),
        tuple(
            (name, values["ivcs"].n, *(values[column.key] for column in MEANS))
            for (name,), values in found.items()
        ),
        (
            "Unweighted means over cells; n counts cells. perfect answers with the labels and "
            "should score 1, silent says nothing and should score 0; constant_velocity and "
            "copy_history see no frame.",
        ),
    )
