"""``ssp extract``: slots with evidence for texts, their blind review, and their measure."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import click
from pydantic import StrictInt

from ssp_core import console
from ssp_core.chat.answer_text import AnswerText, split_answer
from ssp_core.errors import InputError, not_read
from ssp_core.files.reading import MAX_TEXT_BYTES, refuse_named_pipe
from ssp_core.hashing import sha256_file
from ssp_core.options import WholeNumber
from ssp_core.run_file.values import Strict
from ssp_eval.data.labels import Text
from ssp_eval.data.records import BehaviourRecord, parse_line, record_to_json
from ssp_eval.extract.combined.extractor import Extractor, TextExtraction
from ssp_eval.extract.combined.options import extractor_of, llm_options
from ssp_eval.extract.language import NOT_READ
from ssp_eval.extract.measure import load_corpus, measure
from ssp_eval.extract.review.agreement import compare
from ssp_eval.extract.review.answers import load_answers, load_key
from ssp_eval.extract.review.form import write_review
from ssp_eval.extract.review.subset import Candidate, choose, make_subset
from ssp_eval.extract.review.tables import show_measure, show_review

_PATH = click.Path(path_type=Path)


@click.command()
@click.argument("file", metavar="[FILE.jsonl]", required=False)
@llm_options()
@click.option(
    "--review",
    "out",
    type=_PATH,
    metavar="OUT",
    help="Write a blind review of some of the texts for two people to the new folder OUT.",
)
@click.option(
    "--n",
    "count",
    type=WholeNumber(1, 5000),
    default=100,
    show_default=True,
    help="Texts to review.",
)
@click.option(
    "--seed", type=WholeNumber(0), default=0, show_default=True, help="Seed for choosing them."
)
@click.option(
    "--returned",
    type=_PATH,
    nargs=2,
    metavar="A B",
    help="What both reviewers returned, JSON; needs --key.",
)
@click.option("--key", "key_file", type=_PATH, help="Key of the review, key.json.")
@click.option(
    "--measure",
    "corpus",
    type=_PATH,
    metavar="CORPUS.jsonl",
    help="Texts with known slots, to measure the extraction against.",
)
@click.option("--misses", is_flag=True, help="With --measure, list the differences.")
@click.option("--json", "as_json", is_flag=True, help="Print a measure or a review as JSON.")
def extract(
    file: str | None,
    out: Path | None,
    count: int,
    seed: int,
    returned: tuple[Path, Path] | None,
    key_file: Path | None,
    corpus: Path | None,
    misses: bool,
    as_json: bool,
    **llm: Any,
) -> None:
    """Extract slots with evidence from texts.

    FILE.jsonl has lines {"id": …, "text": …}; "-" reads standard input. For each, one line
    {"id": …, "slots": …} goes to standard output, slots as in behaviour records (METHOD 5.3), with
    "language" if the text isn't English and so wasn't read. It also says which slots the learned
    reader filled or took back, and with --llm which the LLM filled. Of an output with reasoning or
    further turns only the answer is read (METHOD 5.4b); it is then given in "answer".

    Instead, --review OUT prepares a blind review of FILE.jsonl by two people, --returned A B
    --key KEY compares what they returned with each other and with the extractor, and --measure
    CORPUS.jsonl compares the extractor with known slots.
    """
    _check_mode(file, out, returned, key_file, corpus)
    if as_json and not (returned or corpus):
        raise click.UsageError("--json is for --measure and --returned; slots are JSON anyway")
    extractor = extractor_of(**llm)
    if returned and key_file:
        review_key = load_key(key_file)
        review = compare(review_key.items, *(load_answers(path, review_key) for path in returned))
        if as_json:
            click.echo(json.dumps(review.to_json(), indent=1))
        else:
            show_review(review)
    elif corpus is not None:
        measurement = measure(load_corpus(corpus), lambda text: extractor(text).slots)
        if as_json:
            click.echo(json.dumps(measurement.to_json(), indent=1))
        else:
            show_measure(measurement, misses)
    elif file is not None and out is not None:
        _prepare(file, out, extractor, count, seed)
    elif file is not None:
        foreign: Counter[str] = Counter()
        for key, text in console.tracked(_read(file), "texts", _count(file)):
            answer = _answer(text)
            found_slots = extractor(answer.text)
            foreign.update([found_slots.language] if found_slots.language else [])
            line = _line(key, answer.text, found_slots, extractor)
            if answer.text != text:
                line |= {"answer": answer.text, "notes": answer.notes}
            click.echo(json.dumps(line))
        if foreign:
            languages = ", ".join(f"{name} {number}" for name, number in sorted(foreign.items()))
            console.note(f"note: texts {NOT_READ}: {languages}")
    if extractor.uses_reader and not returned:
        shares = extractor.shares()
        console.note(
            f"reader: filled {shares['reader_filled']} of {shares['slots_given']} slots, "
            f"took back {shares['reader_withdrawn']} of the rules"
        )
    if extractor.uses_llm:
        tally = ", ".join(f"{name} {number}" for name, number in extractor.tally().items())
        console.note(f"LLM: {tally}")


def _check_mode(
    file: str | None,
    out: Path | None,
    returned: tuple[Path, Path] | None,
    key_file: Path | None,
    corpus: Path | None,
) -> None:
    if (out is not None) + bool(returned) + (corpus is not None) > 1:
        raise click.UsageError("--review, --returned and --measure exclude each other")
    if bool(returned) != (key_file is not None):
        raise click.UsageError("--returned A B and --key KEY belong together")
    if (returned or corpus is not None) == (file is not None):
        option = "--returned" if returned else "--measure"
        raise click.UsageError(
            f"{option} takes no FILE.jsonl besides" if file else "name a FILE.jsonl, or - for stdin"
        )


def _answer(text: str) -> AnswerText:
    """Return the answer within an output; the whole text, as it is, where it is all answer."""
    answer = split_answer(text)
    return answer if len(answer.text) != len(text) else AnswerText(text)


def _line(
    key: str | int, text: str, extraction: TextExtraction, extractor: Extractor
) -> dict[str, Any]:
    record = record_to_json(BehaviourRecord(0.0, text, extraction.slots))
    line = {"id": key, "slots": json.loads(record)["slots"]}
    if extraction.language:
        line["language"] = extraction.language
    if extractor.uses_reader:
        line["reader"] = {"slots": extraction.by_reader, "withdrawn": extraction.withdrawn}
    if extractor.uses_llm:
        trouble = extraction.trouble or None
        line["llm"] = {
            "slots": extraction.by_llm,
            "trouble": trouble,
            "dropped": extraction.dropped,
        }
    return line


def _prepare(file: str, out: Path, extractor: Extractor, count: int, seed: int) -> None:
    if file == "-":
        raise click.UsageError("--review needs a file, whose hash goes into the key")
    candidates = [
        Candidate(key, answer, extractor(answer).slots)
        for key, text in console.tracked(_read(file), "texts", _count(file))
        for answer in (_answer(text).text,)
    ]
    sample = choose([one for one in candidates if one.text.strip()], count, seed)
    if not sample:
        raise InputError(
            "holds no text to review",
            file=file,
            remedy="give a file with texts, one JSON object a line",
        )
    subset = make_subset(sample, sha256_file(file), extractor.sha256, seed)
    write_review(subset, out)
    if len(sample) < count:
        console.note(f"note: {file} has {len(sample)} different texts, fewer than {count}")
    console.note(
        f"{len(sample)} texts of {len(candidates)}; give {out}/reviewer_1 and {out}/reviewer_2 to "
        f"two people, and keep {out}/key.json from them"
    )


def _count(file: str) -> int | None:
    """Count the lines of a file; None: not known yet."""
    if not Path(file).is_file():
        return None
    with open(file, "rb") as stream:
        return sum(block.count(b"\n") for block in iter(partial(stream.read, 1 << 20), b""))


class _Input(Strict):
    id: Text | StrictInt
    text: Text


def _read(file: str) -> Iterator[tuple[str | int, str]]:
    """Yield the ids and texts of a file, one line at a time; blank lines are passed over."""
    lines: dict[str | int, int] = {}
    number = 0
    try:
        if file != "-":
            refuse_named_pipe(file)
        with click.open_file(file, encoding="utf-8") as stream:
            while line := stream.readline(MAX_TEXT_BYTES):
                number += 1
                if len(line) == MAX_TEXT_BYTES:
                    problem = f"has a line of more than {MAX_TEXT_BYTES >> 20} MiB"
                    raise InputError(problem, file=file, remedy="split the line")
                if not line.removeprefix("\ufeff").strip():
                    continue
                content = line.removeprefix("\ufeff") if number == 1 else line
                entry = parse_line(_Input, content, file, number)
                if (first := lines.setdefault(entry.id, number)) != number:
                    problem = f"stands in line {first} already"
                    raise InputError(
                        problem,
                        file=file,
                        line=number,
                        field="id",
                        value=entry.id,
                        remedy="give each text its own id",
                    )
                yield entry.id, entry.text
    except UnicodeDecodeError as error:
        raise InputError(
            "is not UTF-8", file=file, line=number + 1, remedy="save it as UTF-8"
        ) from error
    except OSError as error:
        raise not_read(file, error) from error
