"""Rows without brackets, written as the rows that the adapters read.

Read are mappings in YAML, elements of XML with attributes, elements or a pair in them, lines such
as ``x = 5.0 m, y = 0.0 m``, comma-separated values below a header, columns in JSON, pairs between
semicolons, and pairs that are lines of their own.
"""

from __future__ import annotations

import json
import re

_NUMBER = r"[+\-\u2212\u2013]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_VALUE = rf"(?:{_NUMBER}|[^\s,;|()\[\]\"'<>]{{1,12}})"  # also one that can't be read
_UNREAD, _UNREAD_FIELDS = "(0 ?, 0 ?)", "{0 ?, 0 ?}"  # rows that no adapter reads
_NAME = (
    r"(?:t|time|timestamp|x|y|z|yaw|heading|theta|v|speed|index|step|waypoint)(?:_(?:m|s|ms|mps))?"
)
# A number with its unit: ``time: 1s``, ``x: 5.0 m``.
_MILLI = r"(?:ms|msecs?|milliseconds?)"
_OTHER_LENGTH = r"(?:ft|feet|cm|km|yd)"
_UNIT = rf"(?:{_MILLI}|s|secs?|seconds?|m|met(?:er|re)s?|{_OTHER_LENGTH})"
_MEASURE = rf"{_NUMBER}(?:[ \t]*{_UNIT})?(?![\w.])"
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
_MAPPING_FIELD = rf"{_NAME}:[ \t]*[\"']?{_MEASURE}[\"']?[ \t]*(?:#[^\n]*)?"
_MAPPING = re.compile(
    rf"^(?P<indent>[ \t]*)-[ \t]+(?P<row>{_MAPPING_FIELD}"
    rf"(?:\n(?P=indent)[ \t]+{_MAPPING_FIELD}){{1,4}})$(?!\n(?P=indent)[ \t]+\S)",
    re.IGNORECASE | re.MULTILINE,
)
_POINT = r"(?P<tag>(?:trajectory_?)?(?:way_?)?(?:point|wp|pt|p|pos|position|step))"
_ATTRIBUTE = rf"\s+{_NAME}\s*=\s*[\"'][^\"'<>\n]{{1,24}}[\"']"
_CHILD = rf"<{_NAME}>\s*[^\s<>][^<>\n]{{0,24}}</{_NAME}>\s*"
_ELEMENT = re.compile(
    rf"<{_POINT}(?P<row>(?:{_ATTRIBUTE}){{2,5}})\s*(?:/>|>\s*</(?P=tag)>)", re.IGNORECASE
)
_PARENT = re.compile(
    rf"<{_POINT}(?P<row>(?:{_ATTRIBUTE}){{0,3}}\s*>\s*(?:{_CHILD}){{1,5}})</(?P=tag)>",
    re.IGNORECASE,
)
# A point with its two numbers as its text.
_HOLDER = re.compile(
    rf"<{_POINT}(?P<row>(?:{_ATTRIBUTE}){{0,3}})\s*>\s*(?P<x>{_MEASURE})\s*[,\s]\s*(?P<y>{_MEASURE})\s*"
    r"</(?P=tag)>",
    re.IGNORECASE,
)
_FIELD = re.compile(
    rf"(?P<name>{_NAME})\s*(?:=\s*[\"'](?P<attribute>[^\"'<>\n]+)|>\s*(?P<child>[^\s<>][^<>\n]*)"
    rf"|:[ \t]*[\"']?(?P<value>{_MEASURE}))",
    re.IGNORECASE,
)
_STATED = re.compile(rf"(?P<number>{_NUMBER})[ \t]*(?P<unit>{_UNIT})?", re.IGNORECASE)
_IS_READ = re.compile(_NAMED.replace(_VALUE, _NUMBER), re.IGNORECASE)
_COLUMN = rf"[\"'](?:{_NAME})[\"']\s*:\s*\[[^\[\]{{}}]*\]"
_COLUMNS = re.compile(rf"\{{\s*{_COLUMN}(?:\s*,\s*{_COLUMN}){{1,4}}\s*\}}", re.IGNORECASE)
_HEADER = re.compile(rf"^[ \t]*{_NAME}(?:[ \t]*[,;][ \t]*{_NAME}){{1,4}}[ \t]*$", re.IGNORECASE)
_LEAST = 2  # rows of a list
# Two numbers, and rows of them: "5.0, 0.0; 9.0, 0.0", "t=0.5: 5.0, 0.0; t=1.0: 9.0, 0.0".
_X, _Y = (rf"(?:{axis}[ \t]*[=:][ \t]*)?{_NUMBER}{_LENGTH}" for axis in "xy")
_PAIR = rf"{_X}[ \t]*,[ \t]*{_Y}"
# "5,0; 9,0" may be pairs, or numbers with a decimal comma.
_MAY_BE_DECIMAL = re.compile(r"\s*[+-]?\d+,\d+\s*(?:;\s*[+-]?\d+,\d+\s*)+")
_UNREAD_LIST = "[[0 ?, 0 ?], [0 ?, 0 ?]]"
_PAIR_AT_END = re.compile(rf"{_PAIR}\Z", re.IGNORECASE)
_TIMED_PAIR = rf"(?:(?:t[ \t]*=[ \t]*)?{_NUMBER}[ \t]*s?[ \t]*:[ \t]*)?{_PAIR}"
_SEMICOLONS = re.compile(
    rf"(?<![\w.,;\-+])(?<![,;][ \t])(?P<rows>{_TIMED_PAIR}(?:[ \t]*;[ \t]*{_TIMED_PAIR})+)(?!\w)"
    r"(?:[ \t]*;[ \t]*(?P<rest>[^\n;,\])}]+(?:,[^\n;,\])}]*)?))?",
    re.IGNORECASE,
)
_ROW_LINE = re.compile(rf"(?P<start>{_LINE_START})(?P<row>{_PAIR})(?P<end>[ \t]*[;,]?[ \t]*)", re.I)
_BEGUN = rf"{_VALUE}[ \t]*(?:,[ \t]*(?:{_VALUE})?)?[ \t]*"
_BEGUN_LINE = re.compile(rf"{_LINE_START}{_BEGUN}", re.I)
_BEGUN_PAIR = re.compile(rf"(?=[^a-z]*\Z|.*\d){_BEGUN}", re.I)


def with_brackets(text: str) -> str:
    """Replace rows that name their columns by rows in brackets, in time linear in the length."""
    text = _COLUMNS.sub(_columns, text)
    elements = ((one, _fields) for one in (_ELEMENT, _PARENT, _HOLDER))
    for pattern, replacement in ((_LINE, _line), (_MAPPING, _mapping), *elements):
        if sum(1 for _ in pattern.finditer(text)) >= _LEAST:
            text = pattern.sub(replacement, text)
    return _with_lists_for_values(text)


def with_pairs(text: str) -> str:
    """Replace pairs between semicolons, and those on lines of their own, by rows in brackets."""
    return _with_rows_for_lines(_SEMICOLONS.sub(_between_semicolons, text))


def _line(match: re.Match[str]) -> str:
    is_read = _IS_READ.fullmatch(match["row"]) is not None
    row = f"({match['row'].replace('|', ',')})" if is_read else _UNREAD
    time = f" {match['time']}" if match["time"] else ""
    return f"{match['start']}{row}{time}{match['rest']}"


def _mapping(match: re.Match[str]) -> str:
    row = _fields(match)
    return row if row == match.group() else f"{match['indent']}- {row}"


def _fields(match: re.Match[str]) -> str:
    groups = match.groupdict()
    pairs = [(one["name"], one[one.lastgroup or ""]) for one in _FIELD.finditer(match["row"])]
    pairs += [(axis, groups[axis]) for axis in ("x", "y") if groups.get(axis)]
    fields = [_field(name, value.strip()) for name, value in pairs]
    if not {"x", "y"} <= {_axis(name) for name, _ in fields}:
        return match.group()
    if not all(value for _, value in fields):
        return _UNREAD_FIELDS
    return "{" + ", ".join(f'"{name}": {value}' for name, value in fields) + "}"


def _field(name: str, value: str) -> tuple[str, str]:
    """Return a field with the unit of its value in its name; an empty value can't be read."""
    stated = _STATED.fullmatch(value)
    if stated is None:
        return name, ""
    unit = (stated["unit"] or "").lower()
    if not unit:
        return name, stated["number"]
    is_time = _axis(name) in ("t", "time", "timestamp")
    if is_time != (unit[0] == "s" or re.fullmatch(_MILLI, unit) is not None):
        return name, ""
    if re.fullmatch(_OTHER_LENGTH, unit) is not None:
        return name, f"{stated['number']} {unit}"
    suffix = "m" if not is_time else "s" if unit[0] == "s" else "ms"
    base, _, own = name.partition("_")
    return f"{base}_{suffix}", stated["number"] if own.lower() in ("", suffix) else ""


def _between_semicolons(match: re.Match[str]) -> str:
    if _MAY_BE_DECIMAL.fullmatch(match["rows"]) is not None:
        return _UNREAD_LIST
    rows = [_PAIR_AT_END.sub(r"(\g<0>)", one.strip()) for one in match["rows"].split(";")]
    rest = match["rest"] or ""
    if _BEGUN_PAIR.fullmatch(rest.strip()) is not None:
        rest = "..." if not any(map(str.isalnum, rest)) else _UNREAD
    return ", ".join([*rows, rest] if rest else rows)


def _with_rows_for_lines(text: str) -> str:
    """Replace pairs on lines of their own by rows; a line that only begins one can't be read."""
    lines = text.split("\n")
    at = 0
    while at < len(lines):
        end = at
        while end < len(lines) and _ROW_LINE.fullmatch(lines[end]) is not None:
            end += 1
        run = ";".join(lines[at:end])
        if end - at >= _LEAST and _MAY_BE_DECIMAL.fullmatch(run) is not None:
            lines[at:end] = [_UNREAD_LIST]
            end = at + 1
        elif end - at >= _LEAST:
            for i in range(at, end):
                one = _ROW_LINE.fullmatch(lines[i])
                lines[i] = lines[i] if one is None else f"{one['start']}({one['row']}){one['end']}"
            begun = end < len(lines) and re.search(r"\d", lines[end]) is not None
            if begun and _BEGUN_LINE.fullmatch(lines[end]) is not None:
                lines[end] = _UNREAD
        at = max(end, at + 1)
    return "\n".join(lines)


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
    output_lines: list[str] = []
    at = 0
    while at < len(lines):
        header = lines[at]
        if _HEADER.fullmatch(header) is None or not {"x", "y"} <= _names(header):
            output_lines.append(header)
            at += 1
            continue
        end = at + 1
        while end < len(lines) and re.search(r"\d.*[,;]|[,;].*\d", lines[end]):
            end += 1
        rows = [f"[{line.strip()}]" for line in lines[at + 1 : end]]
        if len(rows) < _LEAST or any("[" in row[1:] or "(" in row for row in rows):
            output_lines += lines[at:end]
        else:
            output_lines.append(
                f"({', '.join(_plain(name) for name in re.split('[,;]', header))})"
                f" [{', '.join(rows)}]"
            )
        at = end
    return "\n".join(output_lines)


def _names(header: str) -> set[str]:
    return {_axis(name.strip()) for name in re.split("[,;]", header)}


def _plain(name: str) -> str:
    """Return a column's name without the unit m, which is the points' own."""
    return re.sub("_m$", "", name.strip(), flags=re.IGNORECASE)


def _axis(name: str) -> str:
    return name.lower().partition("_")[0]
