"""The records of a cell's answers: adapter, then text extraction (METHOD 5.3 to 5.5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from ssp_eval.data.records import BehaviourRecord
from ssp_eval.evaluate.store.requests import Exchange
from ssp_eval.extract.combined.extractor import Extractor, TextExtraction
from ssp_eval.extract.language import NOT_READ
from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.messages import Request, Response

LLM_MISSING = "slots of the LLM are missing"
BY_READER, BY_LLM = "slots by the learned reader", "slots by the LLM"


def records_of(
    exchanges: Sequence[Exchange], adapter: str, extractor: Extractor | None = None
) -> list[BehaviourRecord]:
    """Make one record per answer.

    A label time without an answer leaves no record, which scoring counts as a missing output.

    Args:
        exchanges: the cell's questions with their answers.
        adapter: its name.
        extractor: of the slots; None: rules and reader.

    Raises:
        InputError: there is no such adapter.
    """
    return [
        record_of(one.t_s, one.record_from, adapter, one.request, one.no_previous, extractor)
        for one in exchanges
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
    """Return the record of one raw answer; the same answer always gives the same record.

    Args:
        t_s: clip time of the newest frame that was sent.
        response: the raw answer.
        adapter: its name.
        request: that it answers; an adapter knows an echo of the prompt by it.
        no_previous: why the request held no previous answer though its interface carries one.
        extractor: of the slots; None: rules and reader.

    Raises:
        InputError: there is no such adapter.
    """
    adapted = adapt(adapter, response, request)
    # No file can hold half of a surrogate pair.
    text = adapted.text.encode("utf-8", "replace").decode()
    notes = list(adapted.info.notes)
    if no_previous:
        notes.append(f"asked without a previous answer: {no_previous}")
    extraction = (extractor or Extractor())(text)
    if extraction.language:
        notes.append(f"{NOT_READ}: {extraction.language}")
    notes += _sources(extraction)
    return BehaviourRecord(
        t_s=t_s,
        text=text,
        slots=extraction.slots,
        trajectory=adapted.trajectory,
        invalid=adapted.invalid,
        adapter={**asdict(adapted.info), "notes": notes},
    )


def _sources(extraction: TextExtraction) -> list[str]:
    """List the slots that the rules didn't fill, and the failures of the extraction's LLM."""
    notes = []
    if extraction.by_reader:
        notes.append(f"{BY_READER}: {', '.join(extraction.by_reader)}")
    if extraction.withdrawn:
        notes.append(f"slots the reader took back: {', '.join(extraction.withdrawn)}")
    if extraction.by_llm:
        notes.append(f"{BY_LLM}: {', '.join(extraction.by_llm)}")
    if extraction.trouble:
        notes.append(f"{LLM_MISSING}: {extraction.trouble}")
    return notes
