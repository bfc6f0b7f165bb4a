"""Rows without brackets that name their columns, written as the rows that the adapters read.

Read are mappings in YAML, elements of XML with attributes, lines such as ``x = 5.0 m, y = 0.0 m``,
comma-separated values below a header, and columns in JSON. Numbers that name no column stay as
they are.
"""

from __future__ import annotations

import json
import re

_NUMBER = r"[+\-\u2212\u2013]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_VALUE = rf"(?:{_NUMBER}|[^\s,;|()\[\]\"'<>]{{1,12}})"  # also one that can't be read
_UNREAD = "(0 ?, 0 ?)"  # a row that no adapter reads
_NAME = r"(?:t|time|x|y|z|yaw|heading|theta|v|speed|index|step|waypoint)(?:_(?:m|s|ms|mps))?"
_LENGTH = r"(?:[ \t]*(?:m|meters?|metres?)\b)?"
_LINE_START = (
    r"[ \t>]*(?:(?:\d{1,3}[.):]|[-*•+])[ \t]+)?(?:\*{0,2}(?:way[ -]?point|point|step|wp|p)[ _#]?"
    r"\d{1,3}\*{0,2}[ \t]*[:.)][ \t]*)?"
    rf"(?:\*{{0,2}}(?:at[ \t]+)?(?:t[ \t]*=[ \t]*)?{_NUMBER}[ \t]*"
    r"(?:ms|s|secs?|seconds?)\*{0,2}[ \t]*[:,–-]?[ \t]*)?"
)
_NAMED = (
    rf"x(?:[ \t]*\(m\))?[ \t]*[=:≈][ \t]*{_VALUE}{_LENGTH}[ \t]*[,;|][ \t]*"
    rf"y(?:[ \t]*\(m\))?[ \t]*[=:≈][ \t]*{_VALUE}{_LENGTH}"
)
_LINE = re.compile(
    rf"^(?P<start>{_LINE_START})(?P<row>{_NAMED})(?:[ \t]*[,;|][ \t]*(?P<time>(?:t|time)[ \t]*[=:]"
    rf"[ \t]*{_NUMBER}[ \t]*(?:ms|s|secs?|seconds?)?))?"
    r"(?P<rest>[ \t]*(?:[.;,]|[-–—(#][^\n]*)?)$",
    re.IGNORECASE | re.MULTILINE,
)
_MAPPING = re.compile(
    rf"^(?P<indent>[ \t]*)-[ \t]+(?P<row>{_NAME}:[ \t]*{_NUMBER}[ \t]*"
    rf"(?:\n(?P=indent)[ \t]+{_NAME}:[ \t]*{_NUMBER}[ \t]*){{1,4}})$(?!\n(?P=indent)[ \t]+\S)",
    re.IGNORECASE | re.MULTILINE,
)
_ELEMENT = re.compile(
    r"<(?P<tag>(?:trajectory_?)?(?:way_?)?(?:point|wp|pt|p|pos|position|step))"
    rf"(?P<row>(?:\s+{_NAME}\s*=\s*[\"']{_VALUE}[\"']){{2,5}})\s*"
    r"(?:/>|>\s*</(?P=tag)>)",
    re.IGNORECASE,
)
_FIELD = re.compile(rf"(?P<name>{_NAME})\s*[:=]\s*[\"']?(?P<value>{_VALUE})", re.IGNORECASE)
_IS_READ = re.compile(_NAMED.replace(_VALUE, _NUMBER), re.IGNORECASE)
_COLUMN = rf"[\"'](?:{_NAME})[\"']\s*:\s*\[[^\[\]{{}}]*\]"
_COLUMNS = re.compile(rf"\{{\s*{_COLUMN}(?:\s*,\s*{_COLUMN}){{1,4}}\s*\}}", re.IGNORECASE)
_HEADER = re.compile(rf"^[ \t]*{_NAME}(?:[ \t]*[,;][ \t]*{_NAME}){{1,4}}[ \t]*$", re.IGNORECASE)
_LEAST = 2  # rows of a list


def with_brackets(text: str) -> str:
    """Replace rows that name their columns by rows in brackets, in time linear in the length."""
    text = _COLUMNS.sub(_columns, text)
    for pattern, written in ((_LINE, _line), (_MAPPING, _mapping), (_ELEMENT, _fields)):
        if sum(1 for _ in pattern.finditer(text)) >= _LEAST:
            text = pattern.sub(written, text)
    return _with_lists_for_values(text)


def _line(match: re.Match[str]) -> str:
    is_read = _IS_READ.fullmatch(match["row"]) is not None
    row = f"({match['row'].replace('|', ',')})" if is_read else _UNREAD
    time = f" {match['time']}" if match["time"] else ""
    return f"{match['start']}{row}{time}{match['rest']}"


def _mapping(match: re.Match[str]) -> str:
    row = _fields(match)
    return row if row == match.group() else f"{match['indent']}- {row}"


def _fields(match: re.Match[str]) -> str:
    fields = [(one["name"], one["value"]) for one in _FIELD.finditer(match["row"])]
    if not {"x", "y"} <= {_axis(name) for name, _ in fields}:
        return match.group()
    if any(re.fullmatch(_NUMBER, value) is None for _, value in fields):
        return _UNREAD
    return "{" + ", ".join(f'"{name}": {value}' for name, value in fields) + "}"


def _columns(match: re.Match[str]) -> str:
    """Write columns as a list of rows, or leave them where they aren't numbers of one length."""
    try:
        columns = json.loads(match.group())
    except ValueError:
        return match.group()
    lengths = {len(column) for column in columns.values()}
    values = [value for column in columns.values() for value in column]
    if len(lengths) != 1 or any(type(value) not in (int, float) for value in values):
        return match.group()
    rows = [
        dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)
    ]
    return json.dumps(rows)


def _with_lists_for_values(text: str) -> str:
    """Replace comma-separated values below a header by a list behind the header's names."""
    lines = text.split("\n")
    found: list[str] = []
    at = 0
    while at < len(lines):
        header = lines[at]
        if _HEADER.fullmatch(header) is None or not {"x", "y"} <= _names(header):
            found.append(header)
            at += 1
            continue
        end = at + 1
        while end < len(lines) and re.search(r"\d.*[,;]|[,;].*\d", lines[end]):
            end += 1
        rows = [f"[{line.strip()}]" for line in lines[at + 1 : end]]
        if len(rows) < _LEAST or any("[" in row[1:] or "(" in row for row in rows):
            found += lines[at:end]
        else:
            found.append(
                f"({', '.join(_plain(name) for name in re.split('[,;]', header))})"
                f" [{', '.join(rows)}]"
            )
        at = end
    return "\n".join(found)


def _names(header: str) -> set[str]:
    return {_axis(name.strip()) for name in re.split("[,;]", header)}


def _plain(name: str) -> str:
    """Return a column's name without the unit m, which is the points' own."""
    return re.sub("_m$", "", name.strip(), flags=re.IGNORECASE)


def _axis(name: str) -> str:
    return name.lower().partition("_")[0]
