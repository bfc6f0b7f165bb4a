"""Verifying a package: every byte, every link, audits made again, and what a change breaks."""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ssp_core import __version__
from ssp_core.errors import InputError
from ssp_core.files.folders import check_folder
from ssp_core.files.reading import parse_model
from ssp_eval.audit.evidence.recording import Recording, read_recording
from ssp_eval.audit.judge import judge
from ssp_eval.audit.page import PagePictures, draw, render
from ssp_eval.data.audit import PAGE_FILE, Audit, RecordingEntry
from ssp_eval.data.response import ResponseLimits
from ssp_eval.package.contents import Contents, Index, Problem, missing_parts, nearest
from ssp_eval.package.helpers import Helpers, results
from ssp_eval.package.links import Chains, Links
from ssp_eval.package.log import merged_log
from ssp_eval.package.model import (
    OBJECTS,
    TABLE_FILE,
    UNSEEN,
    Chain,
    FileEntry,
    Link,
    Package,
    Progress,
    load_table,
    object_path,
)
from ssp_eval.package.pages import Comparison, campaigns, check_campaign
from ssp_scenario_manager.event_spec.model import Event

# Where the recordings lay decides nothing, and neither does who judged them.
_FREE_OF_AUDIT = {"software", "recordings", "labels"}
# Labels may be reviewed after the audit, which only counted them.
_FREE_OF_RECORDING = {"bag", "name", "labels"}
# Another processor may round the last digits another way; no verdict hangs on a millionth.
_TOLERANCE = 1e-6
_AUDITS_SHOWN = 8
_WIDEST = 100

_Difference = tuple[str, str]


@dataclass(frozen=True, slots=True)
class StoredAudit:
    """An audit of a package, and what it is judged from.

    Args:
        entry: its file.
        content: what it says.
        places: the MCAP files of its recordings, in its order.
        event: the file of the K* that it names, None where it names none.
    """

    entry: FileEntry
    content: Audit
    places: tuple[FileEntry, ...]
    event: FileEntry | None


@dataclass
class AuditFindings:
    """Differences between audits and what their recordings give.

    Args:
        pages: the pages of these audits.
    """

    problems: list[Problem] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    pages: Comparison = field(default_factory=Comparison)


def stored_audits(index: Index) -> list[StoredAudit]:
    """Read the audits that can be made again; one whose links lead nowhere is a problem already."""
    audits = list[StoredAudit]()
    for entry in index.contents.of("audit"):
        try:
            audit = parse_model(Audit, index.contents.mapping(entry), entry.path)
        except InputError:
            continue  # its links say so
        places = [place for one in audit.recordings if (place := index.place_of(one)) is not None]
        event = nearest(index.events.get(str(audit.event_version), ()), entry.path)
        unknown = audit.event_version is not None and event is None
        if len(places) == len(audit.recordings) and not unknown:
            audits.append(StoredAudit(entry, audit, tuple(places), event))
    return audits


def check_audit(contents: Contents, audit: StoredAudit, scratch: Path) -> AuditFindings:
    """Judge the recordings of an audit again, and hold the audit and its page against the result.

    Args:
        contents: of the package.
        audit: to check.
        scratch: a new folder, for links to the recordings.
    """
    findings = AuditFindings()
    entry, original = audit.entry, audit.content
    limits = None if original.response is None else original.response.limits
    try:
        event = _event(contents, audit.event)
        remake, page_pictures = judge_again(contents, audit.places, event, limits, scratch)
        if original.software != remake.software:
            findings.notes.append(
                f"{entry.path}: made by {original.software}, compared with what ssp "
                f"{__version__} gives"
            )
        wrong = list(_compare(original, remake))
        findings.problems += [Problem(entry.path, at, text) for at, text in wrong[:_AUDITS_SHOWN]]
        if len(wrong) > _AUDITS_SHOWN:
            text = f"{len(wrong) - _AUDITS_SHOWN} more values aren't what the recordings give"
            findings.problems.append(Problem(entry.path, "", text))
        page = contents.beside(entry.path, PAGE_FILE)
        # The page of an audit that doesn't hold would be compared with what is wrong itself.
        if page is not None and not wrong and original.software == remake.software:
            findings.pages.hold(
                contents, page, render(_in_order_of(original, remake), page_pictures)
            )
    except InputError as error:
        findings.problems.append(Problem(entry.path, "", f"can't be made again: {error}"))
    return findings


def _event(contents: Contents, entry: FileEntry | None) -> Event | None:
    if entry is None:
        return None
    return parse_model(Event, contents.mapping(entry), entry.path)


def judge_again(
    contents: Contents,
    places: Sequence[FileEntry],
    event: Event | None,
    limits: ResponseLimits | None,
    scratch: Path,
) -> tuple[Audit, PagePictures]:
    """Return the audit of recordings, each laid out as it lay when it was packed.

    With it come the pictures of its page.
    """
    recordings: list[Recording] = []
    try:
        scratch.mkdir()
        for number, place in enumerate(places):
            recordings.append(read_recording(contents.lay_out(place, scratch / str(number))))
        judgement = judge(recordings, event, limits)
        return judgement.audit, draw(judgement.examined)
    except InputError as error:
        text = str(error)
        for number in range(len(places)):
            text = text.replace(f"{scratch / str(number)}/", "")
        raise InputError(text) from error


def _compare(original: Audit, remake: Audit) -> Iterator[_Difference]:
    """List the differences, verdicts first: the others rest on them."""
    pairs = list(zip(original.recordings, remake.recordings, strict=True))
    for number, (one, other) in enumerate(pairs):
        if one.status != other.status:
            yield _says(f"recordings[{number}].status", one.status, other.status)
    for number, (one, other) in enumerate(pairs):
        codes = [_codes(one), _codes(other)]
        if codes[0] != codes[1]:
            yield _says(f"recordings[{number}].reasons", *codes)
        elif differing := list(
            _differences(
                f"recordings[{number}].reasons", _json(one)["reasons"], _json(other)["reasons"]
            )
        ):
            yield from differing
    for number, (one, other) in enumerate(pairs):
        exclusions = {"status", "reasons"} | _FREE_OF_RECORDING
        yield from _keys(f"recordings[{number}].", _json(one), _json(other), exclusions)
    free = _FREE_OF_AUDIT if original.response is not None else _FREE_OF_AUDIT | {"response"}
    yield from _keys("", _json(original), _json(remake), free)


def _in_order_of(original: Audit, remake: Audit) -> Audit:
    """Return an audit with its keys in the order in which they are judged, not in the file's."""

    def sorted_like(value: Any, other: Any) -> Any:
        if isinstance(value, dict) and isinstance(other, dict):
            names = [name for name in dict.fromkeys((*other, *value)) if name in value]
            return {name: sorted_like(value[name], other.get(name)) for name in names}
        if isinstance(value, list) and isinstance(other, list) and len(value) == len(other):
            return [sorted_like(a, b) for a, b in zip(value, other, strict=True)]
        return value

    return Audit.model_validate(sorted_like(_json(original), _json(remake)))


def _codes(entry: RecordingEntry) -> list[str]:
    return [finding.code for reason in entry.reasons for finding in (reason, *reason.consequences)]


def _json(value: Audit | RecordingEntry) -> dict[str, Any]:
    return value.model_dump(mode="json", by_alias=True)


def _keys(
    prefix: str, original: dict[str, Any], remake: dict[str, Any], without: set[str]
) -> Iterator[_Difference]:
    for key in original:
        if key not in without:
            yield from _differences(f"{prefix}{key}", original[key], remake[key])


def _differences(at: str, original: Any, remake: Any) -> Iterator[_Difference]:
    """Yield field and text of each value that differs."""
    if isinstance(original, dict) and isinstance(remake, dict):
        for key in sorted({*original, *remake}):
            if key in original and key in remake:
                yield from _differences(f"{at}.{key}", original[key], remake[key])
            elif key in original:
                yield f"{at}.{key}", "isn't among what the recordings give"
            else:
                yield f"{at}.{key}", f"is missing; the recordings give {_short(remake[key])}"
    elif isinstance(original, list) and isinstance(remake, list) and len(original) == len(remake):
        for number, (one, other) in enumerate(zip(original, remake, strict=True)):
            yield from _differences(f"{at}[{number}]", one, other)
    elif not _same(original, remake):
        yield _says(at, original, remake)


def _same(original: Any, remake: Any) -> bool:
    numbers = [
        value
        for value in (original, remake)
        if isinstance(value, int | float) and not isinstance(value, bool)
    ]
    if len(numbers) == 2:
        return math.isclose(*numbers, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
    return type(original) is type(remake) and bool(original == remake)


def _says(at: str, original: Any, remake: Any) -> _Difference:
    return at, f"says {_short(original)}, and the recordings give {_short(remake)}"


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 1]}…"


@dataclass(frozen=True)
class Findings:
    """The content of the files.

    Args:
        missing: parts that a whole package would hold.
    """

    links: Sequence[Link]
    chains: Sequence[Chain]
    missing: Sequence[str]
    problems: Sequence[Problem]
    notes: Sequence[str]


def work_out(
    contents: Contents, on_step: Callable[[str], None] = lambda _: None, workers: int = 1
) -> Findings:
    """Read everything and follow every link; the same files always give the same findings.

    Args:
        contents: of the package.
        on_step: called with what is done next, since some of it takes seconds.
        workers: processes, this one included, that share audits and pages.
    """
    again, pages = AuditFindings(), Comparison()
    with (
        tempfile.TemporaryDirectory(prefix="ssp-package-") as scratch,
        Helpers(workers - 1) as helpers,
    ):
        # A page needs nothing from the index: a helper makes it while the index is read here.
        of_campaigns = [
            helpers.begin(check_campaign, contents, root, Path(scratch) / f"campaign-{number}")
            for number, root in enumerate(campaigns(contents))
        ]
        index = Index(contents, on_step)
        of_audits = [
            helpers.begin(check_audit, contents, audit, Path(scratch) / f"audit-{number}")
            for number, audit in enumerate(stored_audits(index))
        ]
        links = Links(index)
        links.derive()
        chains = Chains(index)
        for path, facts in sorted(links.cells.items()):
            chains.add(path, facts)
        on_step("judging the recordings again")
        for findings in results(of_audits):
            again.problems += findings.problems
            again.notes += findings.notes
            pages.add(findings.pages)
        on_step("making the pages again")
        for comparison in results(of_campaigns):
            pages.add(comparison)
    pages.say_what_was_not_compared(contents)
    all_links = [*links.links, *chains.links]
    return Findings(
        links=sorted(all_links, key=lambda link: (link.source, link.at, link.target)),
        chains=chains.chains,
        missing=missing_parts(index, links.cells, all_links),
        problems=list(
            dict.fromkeys(
                [
                    *index.problems,
                    *links.problems,
                    *again.problems,
                    *chains.problems,
                    *pages.problems,
                ]
            )
        ),
        notes=[*index.notes, *again.notes, *chains.notes, *pages.notes],
    )


_BLOCK_BYTES = 1 << 20
_SHOWN = 3
_DAMAGE = ("changed", "missing", "superfluous")


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong with a package.

    Args:
        kind: changed, missing or superfluous (a file); link (a hash that leads nowhere); table.
        file: path that the file had, or its place in the package where it had none.
        object: where its bytes lie in the package, empty where there are none.
        breaks: what rests on the file: cells with their number of scores, audits, tasks.
    """

    kind: str
    file: str
    object: str
    text: str
    breaks: tuple[str, ...] = ()


@dataclass
class Verdict:
    """The result of a verification.

    Args:
        id: of the package, None where its table can't be read.
        findings: empty for a package that is as it was made.
        missing: parts that a whole package would hold, as its table says.
    """

    id: str | None = None
    findings: list[Finding] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    files: int = 0
    links: int = 0
    scores: int = 0

    @property
    def ok(self) -> bool:
        return not self.findings


def verify_package(
    folder: Path,
    *,
    expected_id: str | None = None,
    progress: Progress = UNSEEN,
    workers: int = 1,
) -> Verdict:
    """Check the bytes first, then the links between them.

    Where bytes are wrong, the links that rest on them are named, and the others are not followed
    anew: their files are as they were when they held.

    Args:
        folder: as `ssp package make` left it.
        expected_id: id that it must have, as somebody wrote it down when it was made.
        progress: receives how many bytes there are to read, those read, and each step.
        workers: see work_out.

    Raises:
        InputError: there is no such folder.
    """
    check_folder(folder, "name a folder of `ssp package make`")
    verdict = Verdict()
    try:
        package = load_table(folder)
    except InputError as error:
        text = error.problem if error.field is None else f"{error.field}: {error.problem}"
        verdict.findings.append(Finding("table", TABLE_FILE, TABLE_FILE, text))
        return verdict
    verdict.id, verdict.missing = package.id, package.missing
    if expected_id is not None and package.id != expected_id:
        text = f"is package {package.id}, expected was {expected_id}"
        verdict.findings.append(Finding("table", TABLE_FILE, TABLE_FILE, text))
    progress.total(sum(entry.bytes for entry in package.files))
    verdict.findings += _bytes(folder, package, progress)
    verdict.files = len(package.files)
    if any(finding.kind in _DAMAGE for finding in verdict.findings):
        verdict.notes.append("links were not followed, since files are not as they were")
        return verdict
    _follow(folder, package, verdict, progress.step, workers)
    return verdict


def _bytes(folder: Path, package: Package, progress: Progress) -> Iterable[Finding]:
    by_hash: dict[str, list[FileEntry]] = {}
    paths: set[str] = set()
    for entry in package.files:
        by_hash.setdefault(entry.sha256, []).append(entry)
        if entry.path in paths:
            yield Finding("table", entry.path, "", "stands twice in the table")
        paths.add(entry.path)
    for sha256, entries in sorted(by_hash.items(), key=lambda item: item[1][0].path):
        name = str(object_path(folder, sha256).relative_to(folder))
        problem = _problem(folder / name, sha256, entries[0].bytes, progress)
        if problem is None:
            continue
        kind, text = problem
        for entry in entries:
            yield Finding(kind, entry.path, name, text, _breaks(package, entry.path))
    object_names = {object_path(folder, sha256).name for sha256 in by_hash}
    yield from _superfluous(folder, {TABLE_FILE, OBJECTS}, "")
    if (folder / OBJECTS).is_symlink():
        text = "is a link, and the bytes lie outside the package"
        yield Finding("changed", OBJECTS, OBJECTS, text)
    elif (folder / OBJECTS).is_dir():
        yield from _superfluous(folder / OBJECTS, object_names, f"{OBJECTS}/")


def _problem(path: Path, sha256: str, size: int, progress: Progress) -> tuple[str, str] | None:
    """Say what is wrong with an object, None where it is as it was."""
    digest, byte_count = hashlib.sha256(), 0
    try:
        if not stat.S_ISREG(path.lstat().st_mode):
            return "changed", "is no plain file any more"
        with path.open("rb") as stream:
            while block := stream.read(_BLOCK_BYTES):
                digest.update(block)
                byte_count += len(block)
                progress.bytes(len(block))
    except FileNotFoundError:
        return "missing", "is not there any more"
    except OSError as error:
        return "changed", f"can't be read: {error.strerror}"
    if f"sha256:{digest.hexdigest()}" != sha256:
        return "changed", f"was changed: its {byte_count} bytes have sha256:{digest.hexdigest()}"
    if byte_count != size:
        return "changed", f"has {byte_count} bytes, and {TABLE_FILE} says {size}"
    return None


def _superfluous(folder: Path, names: set[str], prefix: str) -> Iterable[Finding]:
    for name in sorted(os.listdir(folder)):
        if name not in names:
            printable_path = f"{prefix}{name}".encode("utf-8", "replace").decode()
            text = f"is not in {TABLE_FILE}"
            yield Finding("superfluous", printable_path, printable_path, text)


def _breaks(package: Package, path: str) -> tuple[str, ...]:
    """List the files that rest on a file, over any number of links."""
    sources: dict[str, set[str]] = {}
    for link in package.links:
        sources.setdefault(link.target, set()).add(link.source)
    reached, waiting = {path}, [path]
    while waiting:
        for source in sources.get(waiting.pop(), ()):
            if source not in reached:
                reached.add(source)
                waiting.append(source)
    roles = {entry.path: entry.role for entry in package.files}
    scores: dict[str, int] = {}
    for chain in package.chains:
        scores[chain.cell] = scores.get(chain.cell, 0) + 1
    dependents = []
    for other in sorted(reached):
        role = roles.get(other)
        if role == "cell":
            dependents.append(f"{scores.get(other, 0)} scores of {other}")
        elif role in ("audit", "task", "recording") and other != path:
            dependents.append(f"{role} {other}")
    return tuple(dependents)


def _follow(
    folder: Path,
    package: Package,
    verdict: Verdict,
    on_step: Callable[[str], None],
    workers: int,
) -> None:
    """Work the links out anew and compare them with the table."""
    contents = Contents(folder, package.files)
    findings = work_out(contents, on_step, workers)
    verdict.notes += findings.notes
    for problem in findings.problems:
        at = f"{problem.field}: " if problem.field else ""
        verdict.findings.append(
            Finding(
                "link",
                problem.file,
                _object(contents, problem.file),
                f"{at}{problem.text}",
                _breaks(package, problem.file),
            )
        )
    for name, table_lines, worked_out in (
        ("links", _lines(package.links), _lines(findings.links)),
        ("chains", _lines(package.chains), _lines(findings.chains)),
        ("missing", package.missing, findings.missing),
    ):
        for text, items in (
            ("says what its files don't", set(table_lines).difference(worked_out)),
            ("lacks what its files say", set(worked_out).difference(table_lines)),
        ):
            verdict.findings += [
                Finding("table", TABLE_FILE, TABLE_FILE, f"{name}: {text}: {item}")
                for item in sorted(items)[:_SHOWN]
            ]
    verdict.findings += _log(contents)
    verdict.links = len(findings.links)
    verdict.scores = len(findings.chains)


def _lines(items: Iterable[Link | Chain]) -> list[str]:
    return [item.model_dump_json() for item in items]


def _object(contents: Contents, path: str) -> str:
    entry = contents.by_path.get(path)
    return "" if entry is None else str(contents.object(entry).relative_to(contents.folder))


def _log(contents: Contents) -> Iterable[Finding]:
    """Check that the merged log is the one that its parts give."""
    for entry in contents.of("log_merged"):
        try:
            parts = [(part.path, contents.text(part)) for part in contents.of("log")]
            same = merged_log(parts) == contents.text(entry)
        except InputError as error:
            yield Finding("link", entry.path, _object(contents, entry.path), str(error))
            continue
        if not same:
            text = "is not what the parts of the log give"
            yield Finding("link", entry.path, _object(contents, entry.path), text)
