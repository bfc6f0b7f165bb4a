"""The axes, order, units and times that a list's rows and heading state (METHOD 5.4b)."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_vla_bridge.adapters.number_lists import NumberList
from ssp_vla_bridge.adapters.stated_times import (
    Beside,
    Raster,
    Times,
    heading_times,
    in_seconds,
)

Rows = tuple[tuple[float, ...], ...]

_DIRECTIONS = {
    "forward": "forward",
    "forwards": "forward",
    "ahead": "forward",
    "front": "forward",
    "longitudinal": "forward",
    "left": "left",
    "leftward": "left",
    "leftwards": "left",
    "right": "right",
    "rightward": "right",
    "rightwards": "right",
    "lateral": "lateral",
    "sideways": "lateral",
    "backward": "backward",
    "backwards": "backward",
    "rear": "backward",
    "east": "map",
    "north": "map",
    "down": "picture",
    "up": "drop",
}
_NAMES = {
    **_DIRECTIONS,
    "speed": "speed",
    "velocity": "speed",
    "vel": "speed",
    "v": "speed",
    "speeds": "speed",
    "curvature": "curvature",
    "curv": "curvature",
    "kappa": "curvature",
    "κ": "curvature",
    "curvatures": "curvature",
    "k": "curvature",
    "c": "curvature",
    "t": "time",
    "time": "time",
    "timestamp": "time",
    **dict.fromkeys(("t_s", "time_s", "timestamp_s"), "time_s"),
    **dict.fromkeys(("t_ms", "time_ms", "timestamp_ms"), "time_ms"),
    "z": "drop",
    "yaw": "drop",
    "heading": "drop",
    "theta": "drop",
    "height": "drop",
    "index": "drop",
    "idx": "drop",
    "step": "drop",
    "waypoint": "drop",
    "point": "drop",
    "wp": "drop",
    "frame": "drop",
    "timestep": "drop",
    **dict.fromkeys(("confidence", "conf", "probability", "prob", "score", "likelihood"), "drop"),
    "x": "x",
    "y": "y",
    "u": "picture",
    "row": "picture",
    "col": "picture",
    "column": "picture",
    "latitude": "map",
    "longitude": "map",
    "lat": "map",
    "lon": "map",
    "easting": "map",
    "northing": "map",
    "distance": "polar",
    "range": "polar",
    "angle": "polar",
    "bearing": "polar",
    "dx": "difference",
    "dy": "difference",
    "δx": "difference",
    "δy": "difference",
    "acceleration": "acceleration",
    "accel": "acceleration",
    "a": "acceleration",
    "steering": "steering",
    "steer": "steering",
    "radius": "radius",
    "throttle": "throttle",
    "brake": "brake",
    "azimuth": "polar",
    "r": "polar",
    "s": "polar",
    "d": "polar",
}
_DIRECTION = "|".join(sorted(_DIRECTIONS, key=len, reverse=True))
_AXIS = re.compile(
    r"\b([xyz])\b[- ]?(?:axis)?"
    r"(?:\s|=|:|\+|→|is|are|points?|pointing|towards?|to|for|as|the|positive)*"
    rf"\b({_DIRECTION})\b"
)
_AXIS_BEHIND = re.compile(rf"\b({_DIRECTION})\b\s*(?:=|is|:)?\s*\(?\b([xyz])\b")
_MINUS = "-\u2212\u2013"
_COLUMN = rf"((?:(?<!\w)[{_MINUS}+]\s?)?[^\W\d]+)(?: angle| rate)?"
_UNIT_BEHIND = (
    r"(?:\s*[\[(][^\])]*[\])]|\s+(?:in\s+)?(?:m|met(?:er|re)s?|ft|feet|cm|km|(?:k?m|ft)/[sh]|mph|1/m"
    r"|rad/m|m\^-1|s|ms|seconds?)(?![\w/]))?"
)
_TUPLE = re.compile(
    rf"[\[(<]\s*{_COLUMN}{_UNIT_BEHIND}\s*[,;]\s*{_COLUMN}{_UNIT_BEHIND}"
    rf"(?:\s*[,;]\s*{_COLUMN})?(?:\s*[,;]\s*{_COLUMN})?\s*[\])>]"
    rf"|\b(?:format|order|columns?|as)\s*:?\s*{_COLUMN}\s*(?:,|then)\s*{_COLUMN}"
    rf"(?:\s*(?:,|then)\s*{_COLUMN})?"
)
# Columns right before the list, without a bracket: "Curvature, speed:".
_PLAIN_TUPLE = re.compile(
    rf"(?:^|[\n.:]|\b(?:future|predicted|planned|next|my|the))\s*{_COLUMN}{_UNIT_BEHIND}"
    rf"\s*[,;/]\s*{_COLUMN}{_UNIT_BEHIND}\s*(?:\([^()]*\)\s*)?[:=]\W*(?:\([^()]*\))?\W*\Z"
)
# Columns in words: "(lateral offset, positive to the left; distance ahead)".
_BRACKET = re.compile(r"[(\[]([^()\[\]]*)[)\]]")
_COLUMN_WORDS = frozenset(
    {"lateral", "longitudinal", "sideways", "forward", "ahead", "left", "right", "along", "across"}
    | {"offset", "distance", "displacement", "position", "coordinate", "component", "deviation"}
    | {"in", "to", "the", "of", "m", "metres", "meters", "first", "second", "travelled"}
)
_ALONG = frozenset({"longitudinal", "forward", "ahead"})
# Motion, not places: "(speed m/s, curvature)", "(velocity vx, vy)", "(speeds)".
_QUANTITY = (
    r"(?:speeds?|velocit(?:y|ies)|curvatures?|vx|vy|accelerations?|steering(?: angles?)?"
    r"|headings?|yaws?(?: rates?)?)"
)
_MOTION_UNIT = (
    r"(?:\s*(?:in\s+)?[\[(]?(?:k?m/[hs](?:\^?2|²)?|mph|1/m|rad(?:/[ms])?|deg(?:/s)?)[\])]?)?"
)
_MOTION = re.compile(
    rf"[(\[]\s*(?:{_QUANTITY}{_MOTION_UNIT}\s*(?:,|;|/|and|&)\s*){{0,2}}(?:speeds?|velocit(?:y|ies)"
    rf"|curvatures?|vx|vy)\s*{_MOTION_UNIT}(?:\s*(?:,|;|/|and|&)\s*{_QUANTITY}{_MOTION_UNIT})*\s*[)\]]"
    r"|\bvelocit(?:y|ies)\W+vx\b|\bvx\s*,\s*vy\b|\b(?:speeds|velocities) (?:and|&) curvatures\b"
    r"|\b(?:speed|velocity)\s*(?:and|&|/|,)\s*curvature\W{0,3}[:=]\W*\Z"
)
# Places, not motion: "Waypoints: ".
_PLACES = re.compile(
    r"\A(?!.*\b(?:speeds?|velocit\w+|curvatures?)\b)"
    r".*\b(way ?points?|positions?|coordinates?)\b[^\n.]{0,40}[:=]\W*\Z",
    re.DOTALL,
)
_LENGTHS_M = {
    "m": 1.0,
    "metre": 1.0,
    "metres": 1.0,
    "meter": 1.0,
    "meters": 1.0,
    "ft": 0.3048,
    "feet": 0.3048,
    "foot": 0.3048,
    "cm": 0.01,
    "centimetres": 0.01,
    "centimeters": 0.01,
    "mm": 0.001,
    "km": 1000.0,
    "yd": 0.9144,
    "yards": 0.9144,
    "yard": 0.9144,
    "inches": 0.0254,
    "kilometre": 1000.0,
    "kilometres": 1000.0,
    "kilometer": 1000.0,
    "kilometers": 1000.0,
    "millimetres": 0.001,
    "millimeters": 0.001,
    "inch": 0.0254,
    "dm": 0.1,
    "decimetres": 0.1,
    "decimeters": 0.1,
}
_SPEEDS_MPS = {
    "m/s": 1.0,
    "mps": 1.0,
    "km/h": 1 / 3.6,
    "kmh": 1 / 3.6,
    "kph": 1 / 3.6,
    "mph": 0.44704,
    "ft/s": 0.3048,
    "knots": 1852 / 3600,
}
_CURVATURES_PM = {
    "1/m": 1.0,
    "rad/m": 1.0,
    "m^-1": 1.0,
    "m⁻¹": 1.0,
    "1/km": 0.001,
    "deg/m": math.pi / 180,
}
_HUNDREDTHS = re.compile(r"(?<![\d.])100(?![\d.])|\bhundredths?\b|\bcenti")
_NO_UNITS = (
    "m/step",
    "cells",
    "grid cells",
    "px",
    "pixel",
    "pixels",
    "deg",
    "degrees",
    "°",
    "degree",
    "car lengths",
    "vehicle lengths",
    "lane widths",
    "tens of metres",
    "tens of meters",
)
_ALL = sorted(
    {*_LENGTHS_M, *_SPEEDS_MPS, *_CURVATURES_PM, *_NO_UNITS, "normalized", "normalised"},
    key=len,
    reverse=True,
)
_UNIT = re.compile(
    r"(?:[(\[,;]\s*|(?<!\d)/\s*|\bin\s+|\bunits?\W{1,5}(?:are|is)?\s*)("
    + "|".join(map(re.escape, _ALL))
    + r")(?![\w/^])"
)
# Points of a picture or grid, where the unit has further words: "(BEV pixels)".
_PICTURE = re.compile(
    r"(?:[(\[]|\bin )(?:[^\W\d]+ ){1,2}(?P<unit>pixels?|px|voxels?|cells?)\b(?! of \d)"
)
# A unit of several: "units of 10 m", "x10 cm", "1 unit = 10 m".
_MULTIPLE = re.compile(
    r"(?:\bunits? (?:of|=|is)\s*|[(\[,;]\s*[x×*]\s?)(\d*\.?\d+)\s*("
    + "|".join(sorted(map(re.escape, _LENGTHS_M), key=len, reverse=True))
    + r")\b"
)
_SCALED = re.compile(
    r"\b(?:scaled?|multiplied|divided|normali[sz]ed|factor)\b(?: (?:by|to|with|of|factor|a))*"
    r"\W{0,2}\d"
)
# The unit of each axis: "x in m, y in cm".
_UNIT_OF_AXIS = re.compile(
    r"\b([xy])\s*(?:\bin\b|\[|\()\s*("
    + "|".join(sorted(map(re.escape, _LENGTHS_M), key=len, reverse=True))
    + r")\b"
)
# Other words for what the patterns above read.
_USUAL = tuple(
    (re.compile(words), usual)
    for words, usual in (
        (r"\bstarboard\b", "right"),
        (r"\bport(?:side)?\b", "left"),
        (r"\bfirst (?:number|value|coordinate|component|entry|element)\b", "x"),
        (r"\bsecond (?:number|value|coordinate|component|entry|element)\b", "y"),
        (r"\bfrd\b", "x forward, y right"),
        (r"\bflu\b", "x forward, y left"),
        (r"\brfu\b", "x right, y forward"),
        (r"\b(?:kilomet(?:er|re)s?|km) (?:per|an) hour\b|\bkmph\b", "km/h"),
        (r"\bmiles? (?:per|an) hour\b", "mph"),
        (r"\b(?:met(?:er|re)s?|m) per s(?:ec(?:ond)?)?\b", "m/s"),
        (r"\b(?:feet|foot|ft) per s(?:ec(?:ond)?)?\b", "ft/s"),
        (r"\b(?:met(?:er|re)s?|m) per (?:time ?)?step\b", "m/step"),
    )
)
# Another frame than the vehicle's.
_OTHER_FRAME = re.compile(
    r"\b(?:global|world|map|utm|enu|geographic|gps|image|camera|frenet|polar|lidar|sensor|radar)"
    r"[ -]"
    r"(?:frame|coordinates?|coordinate system|axes|space|plane)\b"
    r"|\b(?:utm|wgs[- ]?84|ecef|epsg)\b|(?<=[(\[])\s*(?:ned|enu)\b|\b(?:ned|enu)\s*(?=[)\]])"
    r"|\bin (?:local )?(?:ned|enu)\b"
)
# Ways of single steps, not places.
_DIFFERENCES = re.compile(
    r"\b(?:displacements?|deltas?|increments?|offsets?|differences?)\b[^.\n]{0,20}"
    r"\b(?:per|each|every|between|from the (?:previous|last)|to the (?:previous|next))\b"
    r"|\b(?:each|every) \w+ relative to (?:the )?(?:previous|last|one before)\b"
    r"|\b(?:(?:relative|step[- ]?wise|successive|incremental|consecutive|per[- ]step)[ _]"
    r"(?:displacements?|deltas?|offsets?|increments?|movements?)"
    r"|deltas|displacements|(?<=trajectory )increments"
    r"|deltas?[ _](?:traj\w*|way\w*|paths?|plans?|positions|coordinates)|order deltas?)\b"
    r"(?! (?:from|to|of|relative to|with respect to) (?:the |my |our )?"
    r"(?:ego|vehicle|car|current|present|origin|start|own|position))"
)
# A side beside the name of its axis: "lateral right", "longitudinal (forward)".
_SIDE_OF_AXIS = re.compile(
    r"\b(?:lateral|longitudinal)[ -]?\(?(right|left|forward)(?:wards?)?\)?(?=\s*[,;)\]])"
)
# Which side of a lateral axis is positive.
_POSITIVE_SIDE = re.compile(
    r"(?:positive|\+)\W*(?:(?:is|to|the|towards?|values?|means?|are|curvatures?|a|=)\W*)*(left|right)"
    r"|\b(left|right)(?:wards?)?\W*(?:(?:is|are|being|=)\W*)?(?:positive|\+)"
)
_NEGATIVE_SIDE = re.compile(
    r"\bnegative\W*(?:(?:is|to|the|towards?|values?|means?|are|curvatures?|a|=)\W*)*(left|right)"
    r"|\b(left|right)(?:wards?)?\W*(?:(?:is|are|being|=)\W*)?negative"
)
# A turn to the right as the positive side of a curvature.
_RIGHT_TURN = "curvature to the right"
_MIRRORED = {
    "left": "right",
    "right": "left",
    "forward": "backward",
    "backward": "forward",
    "curvature": _RIGHT_TURN,
    _RIGHT_TURN: "curvature",
}
_BACKWARDS = re.compile(
    r"\b(?:latest|last|newest|farthest|furthest|final) (?:point |one |row |time )?first\b"
    r"|\bfrom (?:the )?(?:last|latest|farthest|furthest|final) (?:\w+ )?(?:back )?to (?:the )?"
    r"(?:first|earliest|nearest|next)\b"
    r"|\brevers\w+(?: chronological)? order\b|\bbackwards? in time\b|\bin reverse\b"
    r"|\border (?:reversed?|descending|backwards?)\b"
)


# The time, in an unknown unit, s or ms, as notes name it.
_TIME_COLUMNS = {"time": "time", "time_s": "time", "time_ms": "time"}
_UNREADABLE = frozenset({"map", "picture", "polar", "backward", "difference"})


@dataclass(frozen=True)
class Meaning:
    """The meaning of an interface's columns, unless the answer states otherwise.

    Args:
        columns: two of ``forward``, ``left``, ``right``, ``speed``, ``curvature``.
        step_s: for an interface whose speed is metres per step, that step; else 1.
        curvature_scale: what a curvature of 1/m is written as.
    """

    columns: tuple[str, str]
    step_s: float = 1.0
    curvature_scale: float = 1.0


POINTS = Meaning(("forward", "left"))
POINTS_RIGHT_FIRST = Meaning(("right", "forward"))
PAIRS = Meaning(("speed", "curvature"))
_NOTHING = Beside()


@dataclass(frozen=True)
class ConvertedRows:
    """A list's rows in an interface's own columns and units.

    Args:
        times_s: as stated, one for each row; empty where none are.
        problem: why it is unknown, empty where it is known.
    """

    rows: Rows
    times_s: tuple[float, ...] = ()
    problem: str = ""
    notes: tuple[str, ...] = ()


def convert(
    one: NumberList,
    heading: str,
    meaning: Meaning,
    accepted: frozenset[str],
    raster: Raster,
    beside: Beside = _NOTHING,
) -> ConvertedRows:
    """Bring a list into its interface's columns and units, as far as it states others.

    Args:
        one: the list, as read.
        heading: the words from the label to the list.
        meaning: the columns and units that the interface asks for.
        accepted: units that are the interface's own.
        raster: the rows that the interface asks for.
        beside: what stands beside the list; the heading's own times go before its.
    """
    of_label = _in_usual_words(heading.lower())
    statement = f"{_in_usual_words(beside.words)}\n{of_label}" if beside.words else of_label
    if beside.problem:
        return ConvertedRows((), problem=beside.problem)
    width = len(one.rows[0]) if one.rows else 0
    notes: list[str] = []
    if any(len(row) != width for row in one.rows):
        return ConvertedRows((), problem="the list has rows of different widths")
    columns = _columns(one, statement, meaning, width)
    if isinstance(columns, str):
        return ConvertedRows((), problem=columns)
    rows, times, changed = _arranged(one.rows, columns, meaning)
    if not rows:
        return ConvertedRows((), problem=f"the list has the columns {', '.join(columns)}")
    if changed:
        names = (_TIME_COLUMNS.get(name, name) for name in columns)
        notes.append(f"converted from the columns ({', '.join(names)})")
    factors = _factors(one, statement, meaning, accepted)
    if isinstance(factors, str):
        return ConvertedRows((), problem=factors)
    if factors[0] != (1.0, 1.0):
        rows = tuple((a * factors[0][0], b * factors[0][1]) for a, b in rows)
        notes.append(f"converted from {factors[1]}")
    if not times.values:
        times = Times(one.times_s, one.times_have_unit)
    if not times.values:
        times = heading_times(of_label, rows, raster)
    if not times.values and beside.words:
        times = heading_times(statement, rows, raster)
    times = in_seconds(times, statement, raster)
    if times.problem:
        return ConvertedRows((), problem=times.problem)
    if not times.values and beside.times_problem:
        return ConvertedRows((), problem=beside.times_problem)
    times_s = times.values
    if _BACKWARDS.search(statement) and not one.times_s:
        rows, times_s = rows[::-1], times_s if times_s == tuple(sorted(times_s)) else times_s[::-1]
        notes.append("converted from the order that it states, latest first")
    if times_s:
        notes.append("at the times that it states")
    return ConvertedRows(rows, times_s, "", tuple(notes))


def states_columns(sentence: str) -> bool:
    """Tell whether a sentence in lower case states axes, order, units or a frame of points."""
    statement = _in_usual_words(sentence)
    stated = (_AXIS, _AXIS_BEHIND, _UNIT, _MULTIPLE, _PICTURE, _OTHER_FRAME, _BACKWARDS)
    return any(one.search(statement) for one in stated)


def _in_usual_words(text: str) -> str:
    for words, usual in _USUAL:
        text = words.sub(usual, text)
    return _SIDE_OF_AXIS.sub(r"\1", text)


def _columns(
    one: NumberList, statement: str, meaning: Meaning, width: int
) -> tuple[str, ...] | str:
    """Return the meaning of each column; or the reason why it isn't known."""
    if "forward" in meaning.columns and (frame := _OTHER_FRAME.search(statement)) is not None:
        return f"the list is in {frame.group()}"
    if "forward" in meaning.columns and _DIFFERENCES.search(statement) is not None:
        return "the list gives the ways of single steps"
    if "forward" in meaning.columns and (motion := _MOTION.search(statement)) is not None:
        return f"the list gives {motion.group()!r}, not places"
    if "speed" in meaning.columns and (places := _PLACES.search(statement)) is not None:
        return f"the list gives {places[1]!r}, not speeds and curvatures"
    axes = {axis: _DIRECTIONS[word] for axis, word in _AXIS.findall(statement)}
    if not axes:
        axes = {axis: _DIRECTIONS[word] for word, axis in _AXIS_BEHIND.findall(statement)}
    negative = _NEGATIVE_SIDE.search(statement)
    negative_side = (negative[1] or negative[2]) if negative is not None else ""
    axes = {a: _MIRRORED[to] if to == negative_side else to for a, to in axes.items()}
    names: list[str] = []
    if any(one.names):
        if any(len(some) > 1 for some in one.names):
            return "the list names its columns in different ways"
        names = [next(iter(some), "") for some in one.names]
    if not all(names):
        names = []
    names = names or _stated_names(statement, meaning, width, not axes)
    side = _lateral_side(statement, meaning, negative_side)
    if not names:
        if width != 2:
            return f"the list has rows of {width} numbers"
        if not axes:
            sides = {"left": side, "right": side, "curvature": _turn(side, statement)}
            return tuple(sides.get(column, column) for column in meaning.columns)
        names = ["x", "z"] if set(axes) == {"x", "z"} else ["x", "y"]
    points = "forward" in meaning.columns
    own = dict(zip(("x", "y"), meaning.columns, strict=True)) if points else {}
    own |= {"lateral": side, "curvature": _turn(side, statement)}
    columns: list[str] = []
    for name in names:
        plain = _plain(name)
        column_meaning = axes.get(plain, _NAMES.get(plain, plain))
        column_meaning = own.get(column_meaning, column_meaning)
        columns.append(_MIRRORED.get(column_meaning, "") if name[0] in _MINUS else column_meaning)
    if columns.count("forward") > 1 or not (_UNREADABLE | {""}).isdisjoint(columns):
        return f"the list names the columns {', '.join(names)}"
    return tuple(columns)


def _stated_names(statement: str, meaning: Meaning, width: int, in_words: bool) -> list[str]:
    """Return the names of columns in a heading, with their signs; empty: it names none."""
    names: list[str] = []
    for match in _TUPLE.finditer(statement):
        words = [word for word in match.groups() if word]
        if len(words) == width and all(_plain(word) in _NAMES for word in words):
            names = words
    if names or width != 2:
        return names
    plain = _PLAIN_TUPLE.search(statement)
    if plain is not None:
        words = [word for word in plain.groups() if word]
        pairs = ({"speed", "curvature"}, {"x", "y"}, {"lateral", "forward"})
        if {_NAMES.get(_plain(word), "") for word in words} in pairs:
            return words
    if not in_words or "forward" not in meaning.columns:
        return []
    for bracket in _BRACKET.findall(statement):
        parts = [re.findall(r"[^\W\d]+", part) for part in re.split("[,;]", bracket)]
        parts = [part for part in parts if part and not {"positive", "negative"} & {*part}]
        if len(parts) == 2 and all(_COLUMN_WORDS.issuperset(part) for part in parts):
            along = [not _ALONG.isdisjoint(part) for part in parts]
            sides = ["lateral" in part or "sideways" in part for part in parts]
            if along == [not side for side in sides] and sum(along) == 1:
                return ["forward" if one else "lateral" for one in along]
    return []


def _plain(name: str) -> str:
    """Return a column's name without its sign."""
    return name.lstrip(f"{_MINUS}+ ")


def _turn(side: str, statement: str) -> str:
    """Return the meaning of a curvature, whose positive side is left unless a heading says more."""
    stated = _POSITIVE_SIDE.search(statement) or _NEGATIVE_SIDE.search(statement)
    return _RIGHT_TURN if stated is not None and side == "right" else "curvature"


def _lateral_side(statement: str, meaning: Meaning, negative_side: str) -> str:
    """Return the side to which a column that is only called lateral counts."""
    if (positive := _POSITIVE_SIDE.search(statement)) is not None:
        return positive[1] or positive[2]
    if negative_side:
        return _MIRRORED[negative_side]
    return "left" if "left" in meaning.columns else "right"


def _arranged(rows: Rows, columns: Sequence[str], meaning: Meaning) -> tuple[Rows, Times, bool]:
    """Arrange rows in an interface's order and signs; also return times and if rows changed."""
    picked: list[tuple[int, float]] = []
    for column in meaning.columns:
        mirrored = _MIRRORED.get(column, column)
        if column in columns:
            picked.append((columns.index(column), 1.0))
        elif mirrored in columns:
            picked.append((columns.index(mirrored), -1.0))
        else:
            return (), Times(), False
    points = "forward" in meaning.columns
    beside = {"speed", "curvature", "acceleration"} if points else set()
    if set(columns) - {
        *_TIME_COLUMNS,
        "drop",
        "left",
        "right",
        _RIGHT_TURN,
        *beside,
        *meaning.columns,
    }:
        return (), Times(), False
    (i, a), (j, b) = picked
    times = _column_of_times(rows, columns)
    if (i, a, j, b) == (0, 1.0, 1, 1.0) and len(columns) == 2:
        return rows, times, False
    # 0.0 − x instead of −x, which would make a negative zero.
    arranged = tuple(
        (row[i] if a > 0 else 0.0 - row[i], row[j] if b > 0 else 0.0 - row[j]) for row in rows
    )
    return arranged, times, True


def _column_of_times(rows: Rows, columns: Sequence[str]) -> Times:
    for place, name in enumerate(columns):
        if name in _TIME_COLUMNS:
            factor = 0.001 if name == "time_ms" else 1.0
            return Times(tuple(factor * row[place] for row in rows), name != "time")
    return Times()


def _factors(
    one: NumberList, statement: str, meaning: Meaning, accepted: frozenset[str]
) -> tuple[tuple[float, float], str] | str:
    """Return the factors of the two columns and the units' names, or why they aren't known."""
    points = "forward" in meaning.columns
    if points and (picture := _PICTURE.search(statement)) is not None:
        return f"the list is in {picture['unit']!r}"
    if points and (stretched := _SCALED.search(statement)) is not None:
        return f"the list is {stretched.group()!r}"
    if points and (multiple := _MULTIPLE.search(statement)) is not None and not one.units:
        factor = float(multiple[1]) * _LENGTHS_M[multiple[2]]
        return (factor, factor), f"{multiple[1]} {multiple[2]}"
    of_axes = (
        dict(_UNIT_OF_AXIS.findall(statement)) if points and not _AXIS.search(statement) else {}
    )
    if len({_LENGTHS_M[unit] for unit in of_axes.values()}) > 1:
        first, second = _LENGTHS_M[of_axes["x"]], _LENGTHS_M[of_axes["y"]]
        return (first, second), f"x in {of_axes['x']}, y in {of_axes['y']}"
    stated = {*one.units, *_UNIT.findall(statement)} - {"s"}
    if "forward" in meaning.columns and len({_LENGTHS_M.get(unit) for unit in one.units}) > 1:
        return f"the rows are in {' and '.join(sorted(one.units))}"
    stated -= accepted & one.units
    if points:
        units_m: dict[str, float] = _LENGTHS_M
        wrong = sorted(stated - units_m.keys())
        lengths = {units_m[unit] for unit in stated - set(wrong)}
        if wrong or len(lengths) > 1:
            return f"the list is in {(wrong or sorted(stated))[0]!r}"
        factor = lengths.pop() if lengths else 1.0
        return (factor, factor), ", ".join(sorted(stated))
    scale = 1.0 if _HUNDREDTHS.search(statement) else meaning.curvature_scale
    speeds = {_SPEEDS_MPS[unit] * meaning.step_s for unit in stated if unit in _SPEEDS_MPS}
    curvatures = {_CURVATURES_PM[unit] * scale for unit in stated if unit in _CURVATURES_PM}
    wrong = sorted(stated - _SPEEDS_MPS.keys() - _CURVATURES_PM.keys() - accepted)
    if wrong or len(speeds) > 1 or len(curvatures) > 1:
        return f"the list is in {(wrong or sorted(stated))[0]!r}"
    factors = (speeds.pop() if speeds else 1.0, curvatures.pop() if curvatures else 1.0)
    return factors, ", ".join(sorted(stated))
