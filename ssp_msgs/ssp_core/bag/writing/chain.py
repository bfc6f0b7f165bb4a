"""The digest chain of a bag as it is written: the records that hold it, and what it is made of.

Three kinds of metadata record are named ``ssp.seal``. The opening one stands behind the header of
each file, one stands before each chunk, and the closing one stands at the end of the data. Each
digest is the SHA-256 of the digest before it and of all bytes since: of a chunk's up to the end
of the chunk, of a closing one up to that record, and of the summary. These two kinds of record are
left out. Of a message above LARGE_BYTES the chain takes the checksum in the chunk's head alone,
since hashing raw pictures takes a tenth of a core. A chain goes on over the files of a bag. It is
no signature: one that was computed anew isn't found.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from mcap.data_stream import RecordBuilder
from mcap.records import McapRecord, Metadata

SEAL_NAME = "ssp.seal"
SOURCE_NAME = "ssp.seal_source"
# A chunk ends with the message with which it reaches 1 MiB, so what is larger is one message.
LARGE_BYTES = 2 << 20
DIGEST_BYTES = hashlib.sha256().digest_size
NOTHING = bytes(DIGEST_BYTES)


class Maker(StrEnum):
    """Kind of program that wrote a bag."""

    RECORDER = "recorder"
    CUT = "cut"
    RECOVER = "recover"
    IMPORT = "import"
    TWIN = "twin"
    DRAW = "draw"
    WRITER = "writer"


# In the state of a bag's seal, for people, and of its sources.
DAMAGED, UNCLOSED = "damaged", "where it ends unclosed"


class Ending(StrEnum):
    """Scope of a closing record: a file that another one follows, or the bag."""

    FILE = "file"
    BAG = "bag"


@dataclass(frozen=True, slots=True)
class Source:
    """A bag of which another one was made, as it was found then.

    Args:
        name: of its folder or file.
        sha256: content hash.
        state: of its seal, for people.
        ends: the digests of its closing records; none where it wasn't sealed or closed.
        altered: it didn't fit its seal, and that was no mere damage.
    """

    name: str
    sha256: str
    state: str
    ends: tuple[str, ...] = ()
    altered: bool = False

    @property
    def is_damaged(self) -> bool:
        """True where a part of the bag could not be read."""
        return self.state.startswith(DAMAGED)

    @property
    def is_unclosed(self) -> bool:
        """True where its recorder did not come to close the bag."""
        return self.state.endswith(UNCLOSED)

    def values(self) -> dict[str, str]:
        """Return the values of the record."""
        return {
            "name": self.name,
            "sha256": self.sha256,
            "state": self.state,
            "ends": " ".join(self.ends),
            "altered": str(self.altered).lower(),
        }

    @classmethod
    def parse(cls, values: dict[str, str]) -> Source:
        """Read a record. Raises ValueError for one that isn't such a record."""
        try:
            return cls(
                values["name"],
                values["sha256"],
                values["state"],
                tuple(values["ends"].split()),
                values["altered"] != "false",
            )
        except KeyError as error:
            raise ValueError(f"a record {SOURCE_NAME} without {error}") from error


def record_bytes(*records: McapRecord) -> bytes:
    """Return records as they stand in a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]  # mcap leaves it bare
    return data


def opening_record(maker: str, file: int, begins: str) -> bytes:
    """Return the record behind the header.

    Args:
        maker: the kind of program that writes the bag, by a ``Maker``.
        file: number of the file in its bag, from 0 on.
        begins: digest with which the file before it ended.
    """
    values = {"made_by": maker, "file": str(file), "begins": begins}
    return record_bytes(Metadata(SEAL_NAME, values))


def chunk_record(number: int, digest: str) -> bytes:
    """Return the record before a chunk; all have one length.

    Args:
        number: of the chunk in its file, from 1 on.
        digest: of the chain up to the end of the chunk, hexadecimal.
    """
    return record_bytes(Metadata(SEAL_NAME, {"chunk": f"{number:08d}", "digest": digest}))


def closing_record(ending: str, summary: str, digest: str) -> bytes:
    """Return the record at the end of a file's data; all of one ending have one length.

    Args:
        ending: how the file ends, by an ``Ending``.
        summary: SHA-256 of the summary behind it.
        digest: of the chain up to this record, hexadecimal.
    """
    values = {"ends": ending, "summary": summary, "digest": digest}
    return record_bytes(Metadata(SEAL_NAME, values))


CHUNK_RECORD_BYTES = len(chunk_record(0, NOTHING.hex()))


class Chain:
    """The chain over the bytes of a bag, in the order in which they stand in its files.

    Args:
        end: digest at which it goes on.
    """

    def __init__(self, end: bytes = NOTHING) -> None:
        self._go_on(end)

    def _go_on(self, end: bytes) -> None:
        self.end = end
        self._hash = hashlib.sha256(end)

    def take(self, buffers: Sequence[bytes | bytearray | memoryview]) -> None:
        """Take what stands in a file; a buffer above LARGE_BYTES is left out."""
        for buffer in buffers:
            if len(buffer) <= LARGE_BYTES:
                self._hash.update(buffer)

    def take_whole(self, data: bytes | bytearray | memoryview) -> None:
        """Take bytes however many they are."""
        self._hash.update(data)

    def close(self) -> str:
        """End the part up to here; gives its digest, with which the next part begins."""
        self._go_on(self._hash.digest())
        return self.end.hex()
