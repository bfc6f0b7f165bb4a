"""Pages of a package, compared with what its files give."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from ssp_core import __version__
from ssp_core.errors import InputError
from ssp_eval.evaluate.store.cell_file import CELL_FILE, CELLS
from ssp_eval.package.contents import Contents, Problem
from ssp_eval.package.model import FileEntry
from ssp_eval.report.making import Making, make_again, making_of
from ssp_eval.report.page import FOLDER, PAGE

_PICTURE = re.compile(r"data:image/jpeg;base64,([A-Za-z0-9+/=]*)")
# Another processor may round a grey level another way when a picture is made smaller.
_LEVELS = 2.0
_AROUND = 40
_SHOWN = 3


@dataclass
class Comparison:
    """Pages held against the same pages made anew.

    Args:
        compared: paths of these pages.
        problems: where they differ.
        notes: why one was not compared.
    """

    compared: set[str] = field(default_factory=set)
    problems: list[Problem] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def hold(self, contents: Contents, page: FileEntry, remake: str) -> None:
        """Hold one page against the same page made anew."""
        self.compared.add(page.path)
        if text := difference(contents.text(page), remake):
            self.problems.append(Problem(page.path, "", text))

    def add(self, other: Comparison) -> None:
        """Add what another comparison found."""
        self.compared |= other.compared
        self.problems += other.problems
        self.notes += other.notes

    def say_what_was_not_compared(self, contents: Contents) -> None:
        """Name the pages that nothing was held against."""
        rest = [e.path for e in contents.of("page") if e.path not in self.compared]
        if rest:
            more = f" and {len(rest) - _SHOWN} more" if len(rest) > _SHOWN else ""
            self.notes.append(
                f"for people, and held against nothing: {', '.join(rest[:_SHOWN])}{more}"
            )


def campaigns(contents: Contents) -> list[PurePosixPath]:
    """Return the folders of the campaigns that have a page."""
    paths = (PurePosixPath(entry.path) for entry in contents.of("cell"))
    roots = (p.parents[2] for p in paths if p.name == CELL_FILE and p.parent.parent.name == CELLS)
    return [root for root in dict.fromkeys(roots) if str(root / PAGE) in contents.by_path]


def check_campaign(contents: Contents, root: PurePosixPath, folder: Path) -> Comparison:
    """Make the page of a campaign again, and compare it with the one that is there.

    Args:
        contents: of the package.
        root: the folder of the campaign in it.
        folder: a new one, in which the page is made.
    """
    comparison = Comparison()
    page = contents.by_path[str(root / PAGE)]
    try:
        _check(contents, root, page, folder, comparison)
    except InputError as error:
        comparison.problems.append(Problem(page.path, "", f"can't be made again: {error}"))
    return comparison


def _check(
    contents: Contents, root: PurePosixPath, page: FileEntry, folder: Path, comparison: Comparison
) -> None:
    making = making_of(contents.text(page), page.path)
    if making is None:
        text = "doesn't say by which options it was made; write it anew with `ssp report`"
        comparison.problems.append(Problem(page.path, "", text))
        return
    if making.software != Making().software:
        comparison.notes.append(
            f"{page.path}: made by {making.software}, and not compared with what ssp "
            f"{__version__} makes"
        )
        return
    if making.repeats:
        comparison.notes.append(
            f"{page.path}: not compared, since answers of {making.repeats} other campaigns "
            "count in it"
        )
        return
    there = {entry.path: entry for entry in contents.files}
    details = f"{root / FOLDER}/"
    _lay_out(contents, root, folder, lambda path: path.startswith(details))
    try:
        make_again(folder, making)
    except InputError as error:
        raise InputError(str(error).replace(f"{folder}/", f"{root}/")) from error
    files = [folder / PAGE, *sorted((folder / FOLDER).glob("*.js"))]
    for file in files:
        path = str(root / file.relative_to(folder).as_posix())
        if path in there:
            comparison.hold(contents, there.pop(path), file.read_text("utf-8"))
        else:
            text = f"lacks {path}, which holds details of a cell"
            comparison.problems.append(Problem(page.path, "", text))
    for path in sorted(there):
        if path.startswith(details):
            text = "holds details of no cell of its campaign"
            comparison.problems.append(Problem(path, "", text))


def _lay_out(
    contents: Contents, root: PurePosixPath, folder: Path, is_made: Callable[[str], bool]
) -> None:
    """Link the files of a campaign into a folder, without those that are made again."""
    links: Mapping[str, FileEntry] = {
        entry.path: entry
        for entry in contents.files
        if PurePosixPath(entry.path).is_relative_to(root)
        and entry.path != str(root / PAGE)
        and not is_made(entry.path)
    }
    for path, entry in links.items():
        place = folder / PurePosixPath(path).relative_to(root)
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            place.symlink_to(contents.object(entry).resolve())
        except OSError as error:
            raise InputError(
                f"can't be laid out: {error.strerror}",
                file=path,
                remedy="make room for temporary files, or set TMPDIR",
            ) from error


def difference(original: str, remake: str) -> str:
    """Say how a page differs from the same page made anew; empty: it doesn't.

    Words must be equal. A picture may have been rounded another way, by two grey levels on average.
    """
    if original == remake:
        return ""
    one, other = _PICTURE.split(original), _PICTURE.split(remake)
    words = "\0".join(one[::2]), "\0".join(other[::2])
    if words[0] != words[1]:
        return _first_difference(*words)
    for number, (a, b) in enumerate(zip(one[1::2], other[1::2], strict=True), start=1):
        if a != b and not _is_same_picture(a, b):
            return f"shows another picture than the package holds: number {number} of the page"
    return ""


def _first_difference(original: str, remake: str) -> str:
    pairs = enumerate(zip(original, remake, strict=False))
    at = next((k for k, (a, b) in pairs if a != b), min(len(original), len(remake)))

    def around(text: str) -> str:
        return " ".join(text[max(0, at - _AROUND // 2) : at + _AROUND].replace("\0", "…").split())

    return f"says …{around(original)}…, and the files of the package give …{around(remake)}…"


def _is_same_picture(original: str, remake: str) -> bool:
    one, other = _decoded(original), _decoded(remake)
    if one is None or other is None or one.shape != other.shape:
        return False
    return float(np.abs(one.astype(np.float32) - other.astype(np.float32)).mean()) <= _LEVELS


def _decoded(text: str) -> np.ndarray | None:
    try:
        data = base64.b64decode(text, validate=True)
    except ValueError:
        return None
    pixels = np.frombuffer(data, np.uint8)
    return cv2.imdecode(pixels, cv2.IMREAD_COLOR) if pixels.size else None
