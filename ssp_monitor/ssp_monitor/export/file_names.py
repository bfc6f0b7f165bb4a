"""File names for topics; a bag from elsewhere may name its topics ``/../../etc/passwd``."""

from __future__ import annotations

import hashlib
import re

_UNUSUAL = re.compile(r"[^A-Za-z0-9_-]")
_MOST_CHARACTERS = 100


class FileNames:
    """Gives each topic one name that no other has, also where large and small are the same."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def of(self, topic: str) -> str:
        """A name of letters, digits, ``_``, ``-`` and ``.``: ``ssp.vut.state`` for /ssp/vut/state.

        What can't be told from the name any more gets a part of the topic's hash.
        """
        parts = topic.strip("/").split("/")
        joined = ".".join(_UNUSUAL.sub("_", part) for part in parts)
        name = joined.strip(".-")  # no hidden file, and none that a program takes for an option
        plain = name == joined and all(part and not _UNUSUAL.search(part) for part in parts)
        if not plain or len(name) > _MOST_CHARACTERS or name.lower() in self._taken:
            digest = hashlib.sha256(topic.encode("utf-8", "surrogatepass")).hexdigest()[:12]
            name = f"{name[:_MOST_CHARACTERS] or 'topic'}-{digest}"
        self._taken.add(name.lower())
        return name
