"""Binds a run's verdict to its bag: ``verdict.json`` lies beside the files and in the last of them.

The file names the seal of the recording, and the bag's seal covers the copy in it, so neither
changes without the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from ssp_core.bag.append import append_attachment, sealed_end
from ssp_core.bag.reader import BagReader
from ssp_core.bag.seal import Seal
from ssp_core.errors import InputError
from ssp_core.files import parse_mapping, write_bytes
from ssp_core.run_file.verdict import VERDICT_FILE, parse_verdict, verdict_bytes
from ssp_core.vocabulary import Verdict

UNBOUND = f"the bag holds no verdict, so nothing shows that the {VERDICT_FILE} beside it is its own"


def leave_verdict(
    bag: Path, verdict: Verdict, reasons: Sequence[str], told_by: Literal["monitor", "runner"]
) -> str:
    """Write a verdict into a bag's folder, over one that is there, and into the bag.

    In a bag the last verdict counts.

    Args:
        bag: folder of a bag that may be unclosed; it holds the file alone then.

    Returns:
        The digest of the whole bag; empty where it isn't closed and sealed.

    Raises:
        HostError: the disk doesn't take it; the bag is as it was then.
    """
    try:
        end = sealed_end(bag)
    except InputError:  # It isn't closed, or is damaged: the file alone says how the run ended.
        end = ""
    data = verdict_bytes(verdict, reasons, told_by, end)
    write_bytes(bag / VERDICT_FILE, data)
    return append_attachment(bag, VERDICT_FILE, data, "application/json") if end else ""


def check_verdict(bag: BagReader, seal: Seal, folder: Path) -> str:
    """Hold the verdict beside a bag against the one in it.

    Args:
        seal: of the bag.
        folder: of the bag.

    Returns:
        What can't be checked, for people; empty where they agree, or where there is no verdict.

    Raises:
        InputError: they don't agree, or the verdict is of another recording.
    """
    file = folder / VERDICT_FILE
    if not file.is_file():
        return ""
    data, inside = file.read_bytes(), bag.attachment(VERDICT_FILE)
    place = f"{bag.path}:{VERDICT_FILE}"
    if inside is not None and data != inside:
        told, kept = parse_verdict(data, file), parse_verdict(inside, place)
        difference = f"the verdict in the bag is {kept.text}"
        if told == kept:
            difference = "the verdict in the bag differs in other words"
        raise InputError(f"says {told.text}; {difference}", file=file,
                         remedy="restore the file as the run left it")  # fmt: skip
    named = parse_mapping(data, str(file)).get("seal")
    ends = (*seal.ends, *(end for source in seal.sources for end in source.ends))
    if named and named not in ends:
        raise InputError(
            "is of another recording: it names a seal that this bag doesn't have",
            file=file, field="seal", value=named, remedy="restore the bag as the run left it",
        )  # fmt: skip
    return "" if inside is not None else UNBOUND
