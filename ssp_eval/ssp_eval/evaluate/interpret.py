"""From raw answers to behaviour records and scores: repeatable without the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from ssp_eval.evaluate.store import Asked
from ssp_eval.extract import extract
from ssp_eval.records import BehaviourRecord
from ssp_vla_bridge.core.adapters import adapt


def records_of(asked: Sequence[Asked], adapter: str) -> list[BehaviourRecord]:
    """One record per answer: adapter, then text extraction (METHOD 5.3 to 5.5).

    A label time without an answer leaves no record, which scoring counts as a missing output.

    Args:
        asked: in label order.
        adapter: name of the adapter.

    Raises:
        InputError: there is no such adapter.
    """
    records = []
    for one in asked:
        response = one.record_from
        if response is None or one.t_s is None:
            continue
        adapted = adapt(adapter, response)
        info = asdict(adapted.info)
        records.append(
            BehaviourRecord(
                t_s=one.t_s,
                text=adapted.text,
                slots=extract(adapted.text),
                trajectory=adapted.trajectory,
                invalid=adapted.invalid,
                adapter={**info, "notes": list(adapted.info.notes)},
            )
        )
    return records
