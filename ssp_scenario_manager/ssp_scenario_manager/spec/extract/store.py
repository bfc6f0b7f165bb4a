"""The folder that keeps what was asked and answered, before anything interprets it.

::

    NAME.extraction/
      index.json          ssp.extraction/1: which answers belong to which request, with hashes
      frames/000123.jpg   what was shown, by number of the source frame
      requests/road-1a2b3c4d.json
      answers/road-1a2b3c4d-1.body    the server's reply, byte for byte

A request's file holds everything that was sent but the pictures, which it names by file and hash.
The name of a request and of its answers holds the start of its hash, so that another request (other
frames, another model, other words) never overwrites an answer, and a finished one is found again.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from ssp_core.errors import InputError
from ssp_core.files import load_model, make_folder, write_bytes, write_json
from ssp_core.hashing import sha256_bytes, sha256_json
from ssp_core.run_file.values import Strict

INDEX_FILE = "index.json"
_HASH_PATTERN = r"^sha256:[0-9a-f]{64}$"
Hash = Annotated[str, Field(pattern=_HASH_PATTERN)]


class StoredAnswer(Strict):
    """One reply: its file, its hash, and why it couldn't be used (empty: it could)."""

    file: Annotated[str, Field(pattern=r"^answers/[a-z0-9_.-]+\.body$")]
    sha256: Hash
    problems: list[str]


class StoredQuestion(Strict):
    """One request and its replies in order."""

    request: str
    request_sha256: Hash
    answers: list[StoredAnswer]


class Index(Strict):
    """The file ``index.json``: requests by ``<question>-<start of its hash>``."""

    schema_: Literal["ssp.extraction/1"] = Field("ssp.extraction/1", alias="schema")
    questions: dict[str, StoredQuestion] = {}


class Store:
    """The folder of one extraction, new or begun before.

    Args:
        folder: made where it isn't there.

    Raises:
        InputError: the folder can't be made, or its index is not valid.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = make_folder(folder)
        index = folder / INDEX_FILE
        self._questions: dict[str, StoredQuestion] = {}
        if index.exists():
            self._questions = dict(load_model(Index, index).questions)

    def keep_frame(self, number: int, jpeg: bytes) -> dict[str, str]:
        """Writes a picture and gives its file and hash, as they stand in requests."""
        name = f"frames/{number:06d}.jpg"
        path = self.folder / name
        if not path.is_file() or path.read_bytes() != jpeg:
            write_bytes(path, jpeg)
        return {"file": name, "sha256": sha256_bytes(jpeg)}

    def begin(self, question: str, request: dict[str, Any]) -> str:
        """Writes a request where it isn't there yet; gives the key of it and its answers."""
        digest = sha256_json(request)
        key = f"{question}-{digest.removeprefix('sha256:')[:8]}"
        if key not in self._questions:
            name = f"requests/{key}.json"
            write_json(self.folder / name, request)
            self._questions[key] = StoredQuestion(request=name, request_sha256=digest, answers=[])
            self._save()
        return key

    def finished(self, key: str) -> bytes | None:
        """The reply to a request that could be used; None: there is none yet.

        Raises:
            InputError: the file is gone or was changed since.
        """
        for answer in self._questions[key].answers:
            if not answer.problems:
                return self._read(answer)
        return None

    def keep(self, key: str, body: bytes) -> str:
        """Writes a reply as it came; gives its file's name."""
        entry = self._questions[key]
        taken = {answer.file for answer in entry.answers}
        number = 1 + len(taken)
        while (name := f"answers/{key}-{number}.body") in taken or (self.folder / name).exists():
            number += 1
        write_bytes(self.folder / name, body)
        return name

    def judge(self, key: str, name: str, problems: Iterable[str]) -> None:
        """Notes whether a kept reply can be used."""
        entry = self._questions[key]
        digest = sha256_bytes((self.folder / name).read_bytes())
        answer = StoredAnswer(file=name, sha256=digest, problems=list(problems))
        self._questions[key] = entry.model_copy(update={"answers": [*entry.answers, answer]})
        self._save()

    def describe(self, keys: Iterable[str]) -> dict[str, dict[str, str]]:
        """Hashes of the requests and of the answers that were used, for the log."""
        found = {}
        for key in keys:
            entry = self._questions[key]
            used = next(answer for answer in entry.answers if not answer.problems)
            found[key] = {"request": entry.request_sha256, "answer": used.sha256}
        return found

    def _read(self, answer: StoredAnswer) -> bytes:
        path = self.folder / answer.file
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"can't be read: {error.strerror}", file=path) from error
        if sha256_bytes(data) != answer.sha256:
            raise InputError(
                "was changed after it was stored",
                file=path,
                value=sha256_bytes(data),
                remedy=f"its hash was {answer.sha256}; remove {self.folder} to ask anew",
            )
        return data

    def _save(self) -> None:
        index = Index(questions=self._questions)
        write_json(self.folder / INDEX_FILE, index.model_dump(mode="json", by_alias=True))
