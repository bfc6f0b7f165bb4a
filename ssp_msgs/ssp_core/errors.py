"""The errors that SSP raises for things that are not its own bugs.

SspError
├── InputError   a file or an argument is wrong: says which, where, and what would be right
├── PeerError    another process or service misbehaved, stayed silent or refused
└── HostError    this machine lacks something

A caller's bug raises a built-in exception (ValueError, TypeError). The command line turns an
SspError into one message and exit code 1; anything else is a traceback and a bug of ours.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Sequence
from pathlib import Path

_MOST_TOLD = 50

# The remedies of what the system says of any file that a command names.
SYSTEM_REMEDIES = {
    errno.ENOSPC: "make room and try again",
    errno.EDQUOT: "make room and try again",
    errno.ENAMETOOLONG: "give a shorter name",
    errno.EROFS: "name another folder",
    errno.EBUSY: "name a new folder within it",  # a mount, or the folder here
    errno.EACCES: "get permission, or name another place",
    errno.EPERM: "get permission, or name another place",
}
_READ_REMEDIES = {
    errno.ENOENT: "name a file that is there",
    errno.ENOTDIR: "name a file that is there",
    errno.EISDIR: "name a file",
    errno.EACCES: "get permission, or name another file",
    errno.ENAMETOOLONG: "name a file that is there",
}


class SspError(Exception):
    """Base of the errors that are reported to people as one message."""


class PeerError(SspError):
    """Another process or service misbehaved, stayed silent or refused."""


class HostError(SspError):
    """This machine lacks something; the message says how to get it."""


def not_written(path: object, error: OSError) -> HostError:
    """Make the error of a file or folder that the system refuses to write, with the remedy."""
    remedy = SYSTEM_REMEDIES.get(error.errno or 0)
    text = f"{path}: can't be written: {error.strerror or error}"
    return HostError(f"{text}; {remedy}" if remedy else text)


class InputError(SspError):
    """Bad input, with the place where it stands and what would be right.

    Args:
        problem: what is wrong, as one clause.
        file: the file it stands in, if any.
        line: line number in that file, from 1.
        field: path of the field, such as ``labels[3].position``.
        value: the offending value; long ones are shortened in the message.
        remedy: what would be right.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: str | Path | None = None,
        line: int | None = None,
        field: str | None = None,
        value: object = None,
        remedy: str | None = None,
    ) -> None:
        self.problem = problem
        self.file = str(file) if file is not None else None
        self.line = line
        self.field = field
        self.value = value
        self.remedy = remedy
        self.parts: tuple[InputError, ...] = ()
        super().__init__(self._message())

    @classmethod
    def of_all(
        cls, errors: Sequence[InputError], file: str | Path | None, line: int | None = None
    ) -> InputError:
        """Make one error that names all of these, each with its field, value and remedy.

        Args:
            errors: at least one; each names its own file where that is another one.
            file: that all of them are about where they name none; None: no file.
            line: of the file, that all of them stand in.
        """
        if len(errors) == 1:
            alone = errors[0].in_file(file)
            return alone if line is None else alone.in_line(line)
        here = (None, None if file is None else str(file))
        parts = [error.in_file(None) if error.file in here else error for error in errors]
        lines = "".join(f"\n  {one}" for one in parts[:_MOST_TOLD])
        more = len(parts) - _MOST_TOLD
        whole = cls(
            f"has {len(parts)} errors:{lines}" + (f"\n  and {more} more" if more > 0 else ""),
            file=file,
            line=line,
        )
        whole.parts = tuple(parts)
        return whole

    def each(self, change: Callable[[InputError], InputError]) -> InputError:
        """Return the error with each of those that it was made of changed; or itself, alone."""
        if not self.parts:
            return change(self)
        return InputError.of_all([change(one) for one in self.parts], self.file, self.line)

    def in_file(self, file: str | Path | None) -> InputError:
        """Return the same error, which stands in that file."""
        return InputError(
            self.problem,
            file=file,
            line=self.line,
            field=self.field,
            value=self.value,
            remedy=self.remedy,
        )

    def in_line(self, line: int) -> InputError:
        """Return the same error, which stands in that line of its file."""
        if self.parts:
            return InputError.of_all(self.parts, self.file, line)
        return InputError(
            self.problem,
            file=self.file,
            line=line,
            field=self.field,
            value=self.value,
            remedy=self.remedy,
        )

    def _message(self) -> str:
        place = self.file or ""
        if self.line is not None:
            place += f":{self.line}" if place else f"line {self.line}"
        parts = [place] if place else []
        if self.field:
            parts.append(self.field)
        text = ": ".join([*parts, self.problem])
        if self.value is not None:
            value_text = repr(self.value)
            text += f" (got {value_text if len(value_text) <= 120 else value_text[:117] + '...'})"
        if self.remedy:
            text += f"; {self.remedy}"
        return text


def not_read(path: str | Path | None, error: OSError) -> InputError:
    """Make the error of a file that the system refuses to read, with the remedy."""
    return InputError(
        f"can't be read: {error.strerror or error}",
        file=path,
        remedy=_READ_REMEDIES.get(error.errno or 0, "give a copy that can be read"),
    )
