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
        beside, inner_verdict = parse_verdict(data, file), parse_verdict(inside, place)
        difference = f"the verdict in the bag is {inner_verdict.text}"
        if beside == inner_verdict:
            difference = "the verdict in the bag differs in other words"
        raise InputError(
            f"says {beside.text}; {difference}",
            file=file,
            remedy="restore the file as the run left it",
        )
    verdict = parse_verdict(data, file)
    _check_result_verdict(result, verdict, folder)
    verdict_seal = parse_mapping(data, str(file)).get("seal")
    ends = (*seal.ends, *(end for source in seal.sources for end in source.ends))
    if verdict_seal and verdict_seal not in ends:
        raise InputError(
            "is of another recording: it names a seal that this bag doesn't have",
            file=file,
            field="seal",
            value=verdict_seal,
            remedy="restore the bag as the run left it",
        )
    if inside is not None:
        return ""
    broken = next((one for one in seal.sources if one.is_damaged or one.is_unclosed), None)
    if broken is not None and verdict.verdict is Verdict.VALID:
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
        run_result = parse_mapping(file.read_bytes(), str(file)) if file.is_file() else {}
    except (InputError, OSError):
        return {}
    ours = run_result.get("schema") == RESULT_SCHEMA and run_result.get("bag") == folder.name
    return run_result if ours else {}


def _check_result_seal(result: dict[str, Any], seal: Seal, folder: Path) -> None:
    result_seal = result.get("seal")
    if result_seal and result_seal != seal.end:
        raise InputError(
            f"names another seal than its bag has, {seal.end or 'which has none'}",
            file=folder.parent / RESULT_FILE,
            field="seal",
            value=result_seal,
            remedy="restore bag and result as the run left them",
        )


def _check_result_verdict(result: dict[str, Any], verdict: RecordedVerdict, folder: Path) -> None:
    result_verdict = result.get("verdict")
    if result_verdict is not None and result_verdict != verdict.verdict.name.lower():
        raise InputError(
            f"says another verdict than its bag, {verdict.text}",
            file=folder.parent / RESULT_FILE,
            field="verdict",
            value=result_verdict,
            remedy="restore bag and result as the run left them",
        )
