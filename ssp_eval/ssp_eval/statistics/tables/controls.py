"""Tables that hold models against controls: blind and spoilt frames, and built-in answerers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ssp_eval.evaluate.clients.models import BLIND, CONDITIONS, condition_of
from ssp_eval.score.aggregate import BY_MODEL, EQUAL, Mean, mean, means
from ssp_eval.score.metrics import METRIC_LABELS
from ssp_eval.statistics.rows import OK, CellRow, merged, one_scale
from ssp_eval.statistics.table import COUNT, MEANS, Column, Table, Value

SEEING, ANSWERERS = "seeing", "answerers"
COMPARED_WITHOUT_SIGHT = ("sem_acc_eff", "cia_eff", "tqsr", "ivcs")
DIFFERENCE = "ivcs_difference"
FINDING = "finding"
AS_MUCH = "scores as much without seeing"
UNPAIRED = "no recording was scored with both"


def control_tables(rows: Sequence[CellRow]) -> list[Table]:
    """Return the tables of the controls that there are, none where there are none."""
    rows = one_scale(rows)
    scored = merged([row for row in rows if row.status == OK])
    models = {row.model for row in rows}
    condition = {row.model: condition_of(row.model)[1] for row in rows if row.control}
    # A blind model whose seeing self wasn't asked stands among the answerers alone.
    condition_names = {
        name
        for name, one in condition.items()
        if one in CONDITIONS or (one == BLIND and condition_of(name)[0] in models)
    }
    blind = [row for row in scored if condition.get(row.model) in ("", BLIND)]
    tables = []
    if condition_names:
        tables.append(seeing_table(scored, sorted(condition_names)))
    if blind:
        tables.append(answerers_table(blind))
    return tables


def seeing_table(rows: Sequence[CellRow], names: Iterable[str]) -> Table:
    """Tabulate each model beside itself under a condition, on the recordings scored with both.

    Args:
        rows: valid ones, one per cell.
        names: of the models under conditions.
    """
    rows_by_key = {row.key: row for row in rows}
    table_rows = []
    for name in names:
        model, condition = condition_of(name)
        pairs = [
            (own, row)
            for row in rows
            if row.model == name and (own := rows_by_key.get((row.scenario, row.domain, model)))
        ]
        table_rows.append(_seeing_row(model, condition, pairs))
    columns = (
        Column("model", "model", "text"),
        Column("condition", "shown", "text"),
        COUNT,
        *(
            column
            for key in COMPARED_WITHOUT_SIGHT
            for column in (
                Column(key, METRIC_LABELS[key]),
                Column(f"{key}_spoilt", f"{METRIC_LABELS[key]}, spoilt"),
            )
        ),
        Column(DIFFERENCE, "IVCS due to seeing", "signed"),
        Column(FINDING, "finding", "text"),
    )
    return Table(
        SEEING,
        "What seeing is worth: each model beside itself with spoilt frames",
        columns,
        tuple(table_rows),
        (
            "Means over the recordings that were scored with both; n counts them. black: all "
            "frames black; shuffled: frames of other times; blind: no pictures, and a prompt that "
            "says so. Everything else in the question stays the same.",
            "The score of a model that scores as much with spoilt frames doesn't come from what it "
            "sees: its answers come from its ego history, its prompt or its habits.",
        ),
    )


def _seeing_row(
    model: str, condition: str, pairs: Sequence[tuple[CellRow, CellRow]]
) -> tuple[Value, ...]:
    values: list[Mean] = [
        mean(getattr(pair[side], key) for pair in pairs)
        for key in COMPARED_WITHOUT_SIGHT
        for side in (0, 1)
    ]
    # Of the two means rather than the mean difference: IVCS is never null, so they are the same.
    own, spoilt = (one.value for one in values[-2:])
    difference = None if own is None or spoilt is None else own - spoilt
    finding = UNPAIRED if difference is None else AS_MUCH if difference <= EQUAL else ""
    return model, condition, len(pairs), *values, difference, finding


def answerers_table(rows: Sequence[CellRow]) -> Table:
    """Return means of the harness's own answerers.

    Args:
        rows: of controls without a condition; valid ones, one per cell.
    """
    means_by_model = means([row.cell() for row in rows], BY_MODEL)
    return Table(
        ANSWERERS,
        "The harness's own answerers",
        (Column("model", "control", "text"), COUNT, *MEANS),
        tuple(
            (name, values["ivcs"].n, *(values[column.key] for column in MEANS))
            for (name,), values in means_by_model.items()
        ),
        (
            "Unweighted means over cells; n counts cells. perfect answers with the labels and "
            "should score 1, silent says nothing and should score 0; constant_velocity and "
            "copy_history see no frame, nor does a model marked as blind (NAME+blind). "
            "best_constant is the one answer of each scenario that scores most when it is always "
            "given; it was chosen using the labels and sees nothing.",
        ),
    )
