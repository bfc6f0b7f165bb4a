"""An EMM-AU annotation beside a clip: checked, kept as provenance, never taken for an answer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from ssp_core.files import load_model
from ssp_core.hashing import sha256_file
from ssp_core.run_file.values import Strict

Sentence = Annotated[str, Field(min_length=1, max_length=10_000)]


class AnnotatedEvent(Strict):
    """What somebody wrote about one event of a video."""

    description: Sentence
    justification: Sentence


class Annotation(Strict):
    """``{video_id, events: [{description, justification}]}``."""

    video_id: Annotated[str, Field(min_length=1, max_length=200)]
    events: Annotated[list[AnnotatedEvent], Field(min_length=1, max_length=100)]

    @property
    def text(self) -> str:
        """As a model may be shown it: descriptions alone, which say what is to be seen."""
        return "\n".join(f"- {event.description}" for event in self.events)


def load_annotation(path: Path) -> tuple[Annotation, str]:
    """An annotation and the hash of its file.

    Raises:
        InputError: it can't be read, or is no such annotation.
    """
    return load_model(Annotation, path), sha256_file(path)
