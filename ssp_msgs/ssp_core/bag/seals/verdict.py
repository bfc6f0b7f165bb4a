"""Binds a run's verdict to its bag: ``verdict.json`` lies beside the files and in the last of them.

The file names the seal of the recording, and the bag's seal covers the copy in it, so neither
changes without the other. ``result.json`` in the run's folder names the digest of the finished bag,
and its verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.append import append_attachment, sealed_end
from ssp_core.bag.seals.seal import Seal
from ssp_core.errors import InputError
from ssp_core.files.reading import parse_mapping
from ssp_core.files.writing import write_bytes
from ssp_core.run_file.verdict import (
    RESULT_FILE,
    RESULT_SCHEMA,
    VERDICT_FILE,
    RecordedVerdict,
    parse_verdict,
    verdict_bytes,
)
from ssp_core.vocabulary import Verdict

UNBOUND = f"the bag holds no verdict, so nothing shows that the {VERDICT_FILE} beside it is its own"


def leave_verdict(
    bag: Path, verdict: Verdict, reasons: Sequence[str], told_by: Literal["monitor", "runner"]
) -> str:
    """Write a verdict into a bag's folder, over one that is there, and into the bag.

    In a bag the last verdict counts.

    Args:
        bag: folder of a bag that may be unclosed; it holds the file alone then.
        verdict: of the run.
        reasons: for it, the primary one first.
        told_by: the one that decided it.

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
        bag: the open bag.
        seal: of the bag.
        folder: of the bag.

    Returns:
        What can't be checked, for people; empty where they agree, or where there is no verdict.

    Raises:
        InputError: they don't agree, or the verdict is of another recording; it calls valid a bag
            that wasn't closed; or the run's result names another seal or verdict.
    """
    result = result_beside(folder) if bag.path.is_dir() else {}
    _check_result_seal(result, seal, folder)
    file = folder / VERDICT_FILE
    if not file.is_file():
        return ""
    data, inside = file.read_bytes(), bag.attachment(VERDICT_FILE)
    place = f"{bag.path}:{VERDICT_FILE}"
    if inside is not None and data != inside:
        beside, kept = parse_verdict(data, file), parse_verdict(inside, place)
        difference = f"the verdict in the bag is {kept.text}"
        if beside == kept:
            difference = "the verdict in the bag differs in other words"
        raise InputError(
            f"says {beside.text}; {difference}",
            file=file,
            remedy="restore the file as the run left it",
        )
    told = parse_verdict(data, file)
    _check_result_verdict(result, told, folder)
    named = parse_mapping(data, str(file)).get("seal")
    ends = (*seal.ends, *(end for source in seal.sources for end in source.ends))
    if named and named not in ends:
        raise InputError(
            "is of another recording: it names a seal that this bag doesn't have",
            file=file,
            field="seal",
            value=named,
            remedy="restore the bag as the run left it",
        )
    if inside is not None:
        return ""
    broken = next((one for one in seal.sources if one.is_damaged or one.is_unclosed), None)
    if broken is not None and told.verdict is Verdict.VALID:
        raise InputError(
            f"says valid, the bag holds no verdict, and it was made of {broken.name}, "
            f"{broken.state}: no runner calls such a recording valid",
            file=file,
            remedy="restore the bag as the run left it",
        )
    return UNBOUND


def result_beside(folder: Path) -> dict[str, Any]:
    """Read the result of the run that left a bag; empty where none lies there, or another's."""
    file = folder.parent / RESULT_FILE
    try:
        found = parse_mapping(file.read_bytes(), str(file)) if file.is_file() else {}
    except (InputError, OSError):
        return {}
    ours = found.get("schema") == RESULT_SCHEMA and found.get("bag") == folder.name
    return found if ours else {}


def _check_result_seal(result: dict[str, Any], seal: Seal, folder: Path) -> None:
    named = result.get("seal")
    if named and named != seal.end:
        raise InputError(
            f"names another seal than its bag has, {seal.end or 'which has none'}",
            file=folder.parent / RESULT_FILE,
            field="seal",
            value=named,
            remedy="restore bag and result as the run left them",
        )


def _check_result_verdict(result: dict[str, Any], told: RecordedVerdict, folder: Path) -> None:
    named = result.get("verdict")
    if named is not None and named != told.verdict.name.lower():
        raise InputError(
            f"says another verdict than its bag, {told.text}",
            file=folder.parent / RESULT_FILE,
            field="verdict",
            value=named,
            remedy="restore bag and result as the run left them",
        )
