"""Rules, learned reader and, where one is given, an LLM as one extractor (METHOD 5.5)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from ssp_core.chat.answer_text import split_answer
from ssp_core.chat.client import Chat
from ssp_core.chat.completion import NoCompletion, read_completion
from ssp_core.errors import PeerError, not_read
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_bytes
from ssp_core.hashing import sha256_bytes, sha256_json
from ssp_eval.data.records import SLOT_NAMES, Slots
from ssp_eval.extract.engine import extractor_hash, read
from ssp_eval.extract.language import foreign_language
from ssp_eval.extract.llm.judge import judge
from ssp_eval.extract.llm.prompt import build_request, prompt_hash
from ssp_eval.extract.llm.reply import read_reply
from ssp_eval.extract.reader.reader import complete, reader_hash

MAX_CHARACTERS = 20_000  # of a text that the LLM is asked about
MAX_FAILURES = 5  # in a row, after which the service isn't asked any more


@dataclass(frozen=True)
class TextExtraction:
    """The result for one text.

    Args:
        slots: of rules, reader and LLM together.
        by_reader: names of the slots that the reader filled.
        withdrawn: names of the slots that the rules filled and the reader emptied.
        by_llm: names of the slots that the LLM filled.
        trouble: why the LLM's part is missing, "" where it isn't.
        dropped: proposals of the LLM that failed a check, as "slot: why".
        language: of a text that isn't English, which the rules don't read.
    """

    slots: Slots
    by_reader: tuple[str, ...] = ()
    withdrawn: tuple[str, ...] = ()
    by_llm: tuple[str, ...] = ()
    trouble: str = ""
    dropped: tuple[str, ...] = ()
    language: str | None = None


class Extractor:
    """Extracts slots from texts and counts who filled them, and what became of the LLM's part.

    Args:
        chat: the LLM; None: none.
        cache: folder that keeps its answers byte for byte, each by the hash of the whole request
            (model, prompt, parameters, text), so that no question is paid for twice; None: none.
        use_schema: ask the server to hold answers to a schema.
        note: called with each failure of the service.
        use_reader: let the learned reader fill what the rules leave empty, before an LLM does.

    Raises:
        InputError: the folder can't be made or written to.
    """

    def __init__(
        self,
        chat: Chat | None = None,
        cache: Path | None = None,
        use_schema: bool = True,
        note: Callable[[str], None] | None = None,
        use_reader: bool = True,
    ) -> None:
        self._chat, self._cache = chat, make_folder(cache) if cache else None
        self._use_schema, self._note, self._use_reader = use_schema, note, use_reader
        self._failures = 0
        self.counts: Counter[str] = Counter()

    def __call__(self, text: str) -> TextExtraction:
        """Return the slots of a text; an LLM's failure costs only its slots of this text.

        Raises:
            InputError: the cache can't be read or written.
        """
        language = foreign_language(text)
        extracted = replace(self._slots(text, language is None), language=language)
        slot_count = sum(getattr(extracted.slots, name) is not None for name in SLOT_NAMES)
        self.counts["slots_given"] += slot_count
        self.counts["reader_filled"] += len(extracted.by_reader)
        self.counts["reader_withdrawn"] += len(extracted.withdrawn)
        return extracted

    def _slots(self, text: str, is_english: bool) -> TextExtraction:
        reading = read(text)
        if not (self._use_reader and is_english):
            return self._with_llm(text, TextExtraction(reading.slots))
        judgement = complete(text, reading)
        extraction = TextExtraction(judgement.slots, judgement.filled, judgement.withdrawn)
        return self._with_llm(text, extraction)

    def _with_llm(self, text: str, extraction: TextExtraction) -> TextExtraction:
        """Fill the slots that are still empty by the LLM."""
        prior_slots = extraction.slots
        empty = [name for name in SLOT_NAMES if getattr(prior_slots, name) is None]
        if self._chat is None or not empty or not text.strip():
            return extraction
        body = self._answer(self._chat, text, empty)
        if isinstance(body, str):
            return replace(extraction, trouble=body)
        completion = read_completion(body)
        proposals = read_reply(split_answer(completion.text or "").text, empty)
        trouble = "it ends in the midst" if completion.cut_off else proposals.unreadable
        trouble = trouble if completion.refusal is None else "the model declines"
        if trouble:
            self.counts["unusable"] += 1
            return replace(extraction, trouble=f"the LLM's answer can't be used: {trouble}")
        judgement = judge(text, prior_slots, proposals.items)
        dropped = (*proposals.dropped, *judgement.dropped)
        self.counts["slots_filled"] += len(judgement.slots)
        self.counts["proposals_dropped"] += len(dropped)
        slots = replace(prior_slots, **judgement.slots)
        return replace(extraction, slots=slots, by_llm=tuple(judgement.slots), dropped=dropped)

    @property
    def sha256(self) -> str:
        """Hash of all that decides what is extracted: rules, reader; model, prompt, parameters."""
        if self._chat is None and not self._use_reader:
            return extractor_hash()
        parts: dict[str, Any] = {"rules": extractor_hash()}
        if self._use_reader:
            parts["reader"] = reader_hash()
        if self._chat is not None:
            parts["llm"] = self._identity(self._chat)
        return sha256_json(parts)

    @property
    def uses_reader(self) -> bool:
        """Tell whether the learned reader fills what the rules leave empty."""
        return self._use_reader

    @property
    def uses_llm(self) -> bool:
        """Tell whether there is an LLM besides the rules."""
        return self._chat is not None

    def describe(self) -> dict[str, Any]:
        """Describe the extractor, and the outcome of its questions so far, for provenance."""
        reader = {"weights": reader_hash(), "counts": self.shares()} if self._use_reader else None
        description: dict[str, Any] = {"rules": extractor_hash(), "reader": reader, "llm": None}
        if self._chat is not None:
            description["llm"] = {**self._identity(self._chat), "counts": self.tally()}
        return description

    def shares(self) -> dict[str, int]:
        """Slots that were given, those of them that the reader filled, and those it took back."""
        return {n: self.counts[n] for n in ("slots_given", "reader_filled", "reader_withdrawn")}

    def tally(self) -> dict[str, int]:
        """Texts by what became of their question, and proposals by what became of them.

        ``asked`` of the server and ``cached`` ones were answered; ``failed`` had no answer from the
        service, ``not_asked`` came after too many of these, ``too_long`` were no question, and
        the answer to ``unusable`` ones held nothing that could be read.
        """
        names = ("asked", "cached", "failed", "not_asked", "too_long", "unusable")
        return {name: self.counts[name] for name in (*names, "slots_filled", "proposals_dropped")}

    def _tell(self, text: str) -> None:
        if self._note is not None:
            self._note(text)

    def _identity(self, chat: Chat) -> dict[str, Any]:
        return {
            "model": chat.model,
            "prompt_and_parameters": prompt_hash(),
            "schema": self._use_schema,
            "checks": _checks_hash(),
        }

    def _answer(self, chat: Chat, text: str, empty: list[str]) -> bytes | str:
        """Return the body of the LLM's answer, or why there is none."""
        if len(text) > MAX_CHARACTERS:
            self.counts["too_long"] += 1
            return f"the text is longer than {MAX_CHARACTERS} characters"
        sendable = text.encode("utf-8", "replace").decode()  # halves of surrogate pairs as ?
        request = build_request(chat.model, sendable, empty, self._use_schema)
        digest = sha256_json(request)
        name = digest.removeprefix("sha256:")
        cache_file = self._cache / name[:2] / f"{name}.body" if self._cache else None
        body = _read_cache(cache_file)
        if body is not None:
            self.counts["cached"] += 1
            return body
        if self._failures >= MAX_FAILURES:
            self.counts["not_asked"] += 1
            return "not asked any more: the service failed too often in a row"
        del request["model"]
        messages = request.pop("messages")
        try:
            body = chat.ask(messages, request)
            read_completion(body)
        except (PeerError, NoCompletion) as error:
            self._failures += 1
            self.counts["failed"] += 1
            self._tell(f"the LLM gave no answer: {error}")
            if self._failures == MAX_FAILURES:
                self._tell(f"{MAX_FAILURES} failures in a row; the LLM isn't asked any more")
            return f"no answer: {error}"
        self._failures = 0
        self.counts["asked"] += 1
        if cache_file is not None:
            write_bytes(cache_file, body)
        return body


@cache
def _checks_hash() -> str:
    """Hash the files that read and judge the LLM's answers."""
    names = ("reply.py", "judge.py", "support.py", "support.yaml")
    folder = Path(__file__).parent.with_name("llm")
    return sha256_json({n: sha256_bytes((folder / n).read_bytes()) for n in names})


def _read_cache(path: Path | None) -> bytes | None:
    """Return an answer in the cache; None where no usable one is there."""
    try:
        body = path.read_bytes() if path is not None else b""
        read_completion(body)
    except (FileNotFoundError, NoCompletion):
        return None
    except OSError as error:
        raise not_read(path, error) from error
    return body
