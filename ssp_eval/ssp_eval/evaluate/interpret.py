"""From raw answers to behaviour records and scores: repeatable without the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from ssp_eval.evaluate.store import Asked
from ssp_eval.extract.language import NOT_READ
from ssp_eval.extract.llm import Extracted, Extractor, make_extractor
from ssp_eval.records import BehaviourRecord
from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.messages import Request, Response

LLM_MISSING = "slots of the LLM are missing"


def records_of(
    asked: Sequence[Asked], adapter: str, extractor: Extractor | None = None
) -> list[BehaviourRecord]:
    """One record per answer: adapter, then text extraction (METHOD 5.3 to 5.5).

    A label time without an answer leaves no record, which scoring counts as a missing output.

    Args:
        asked: in label order.
        adapter: name of the adapter.
        extractor: of the slots; None: the rules alone.

    Raises:
        InputError: there is no such adapter.
    """
    return [
        record_of(one.t_s, one.record_from, adapter, one.request, one.no_previous, extractor)
        for one in asked
        if one.record_from is not None and one.t_s is not None
    ]


def record_of(
    t_s: float,
    response: Response,
    adapter: str,
    request: Request | None = None,
    no_previous: str = "",
    extractor: Extractor | None = None,
) -> BehaviourRecord:
    """The record of one raw answer; the same answer always gives the same record.

    Args:
        t_s: clip time of the newest frame that was sent.
        response: as it came.
        adapter: name of the adapter, with its mode.
        request: that it answers; an adapter knows an echo of the prompt by it.
        no_previous: why the request held no previous answer though its interface carries one.
        extractor: of the slots; None: the rules alone.

    Raises:
        InputError: there is no such adapter.
    """
    adapted = adapt(adapter, response, request)
    notes = list(adapted.info.notes)
    if no_previous:
        notes.append(f"asked without a previous answer: {no_previous}")
    found = (extractor or make_extractor())(adapted.text)
    if found.language:
        notes.append(f"{NOT_READ}: {found.language}")
    notes += _llm_notes(found)
    return BehaviourRecord(
        t_s=t_s,
        text=adapted.text,
        slots=found.slots,
        trajectory=adapted.trajectory,
        invalid=adapted.invalid,
        adapter={**asdict(adapted.info), "notes": notes},
    )


def _llm_notes(found: Extracted) -> list[str]:
    """What the LLM of the extraction did or couldn't do; nothing where there is none."""
    notes = []
    if found.by_llm:
        notes.append(f"slots by the LLM: {', '.join(found.by_llm)}")
    if found.trouble:
        notes.append(f"{LLM_MISSING}: {found.trouble}")
    return notes
