"""The axes, order, units and times that a list's rows and heading state (METHOD 5.4b)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_vla_bridge.adapters import stated_words as words
from ssp_vla_bridge.adapters.number_lists import NumberList
from ssp_vla_bridge.adapters.stated_times import Beside, Raster, Times, heading_times, in_seconds

Rows = tuple[tuple[float, ...], ...]

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
    of_label = words.in_usual_words(heading.lower())
    statement = f"{words.in_usual_words(beside.words)}\n{of_label}" if beside.words else of_label
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
    if words.BACKWARDS.search(statement) and not one.times_s:
        rows, times_s = rows[::-1], times_s if times_s == tuple(sorted(times_s)) else times_s[::-1]
        notes.append("converted from the order that it states, latest first")
    if times_s:
        notes.append("at the times that it states")
    return ConvertedRows(rows, times_s, "", tuple(notes))


def states_columns(sentence: str) -> bool:
    """Tell whether a sentence in lower case states axes, order, units or a frame of points."""
    statement = words.in_usual_words(sentence)
    stated = (
        words.AXIS,
        words.AXIS_BEHIND,
        words.UNIT,
        words.MULTIPLE,
        words.PICTURE,
        words.OTHER_FRAME,
        words.BACKWARDS,
    )
    return any(one.search(statement) for one in stated)


def _columns(
    one: NumberList, statement: str, meaning: Meaning, width: int
) -> tuple[str, ...] | str:
    """Return the meaning of each column; or the reason why it isn't known."""
    if "forward" in meaning.columns and (frame := words.OTHER_FRAME.search(statement)) is not None:
        return f"the list is in {frame.group()}"
    if "forward" in meaning.columns and words.DIFFERENCES.search(statement) is not None:
        return "the list gives the ways of single steps"
    if "forward" in meaning.columns and (motion := words.MOTION.search(statement)) is not None:
        return f"the list gives {motion.group()!r}, not places"
    if "speed" in meaning.columns and (places := words.PLACES.search(statement)) is not None:
        return f"the list gives {places[1]!r}, not speeds and curvatures"
    axes = {axis: words.DIRECTIONS[word] for axis, word in words.AXIS.findall(statement)}
    if not axes:
        axes = {axis: words.DIRECTIONS[word] for word, axis in words.AXIS_BEHIND.findall(statement)}
    negative = words.NEGATIVE_SIDE.search(statement)
    negative_side = (negative[1] or negative[2]) if negative is not None else ""
    axes = {a: words.MIRRORED[to] if to == negative_side else to for a, to in axes.items()}
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
        column_meaning = axes.get(plain, words.NAMES.get(plain, plain))
        column_meaning = own.get(column_meaning, column_meaning)
        columns.append(
            words.MIRRORED.get(column_meaning, "") if name[0] in words.MINUS else column_meaning
        )
    if columns.count("forward") > 1 or not (_UNREADABLE | {""}).isdisjoint(columns):
        return f"the list names the columns {', '.join(names)}"
    return tuple(columns)


def _stated_names(statement: str, meaning: Meaning, width: int, in_words: bool) -> list[str]:
    """Return the names of columns in a heading, with their signs; empty: it names none."""
    names: list[str] = []
    for match in words.TUPLE.finditer(statement):
        column_words = [word for word in match.groups() if word]
        if len(column_words) == width and all(_plain(word) in words.NAMES for word in column_words):
            names = column_words
    if names or width != 2:
        return names
    plain = words.PLAIN_TUPLE.search(statement)
    if plain is not None:
        column_words = [word for word in plain.groups() if word]
        pairs = ({"speed", "curvature"}, {"x", "y"}, {"lateral", "forward"})
        if {words.NAMES.get(_plain(word), "") for word in column_words} in pairs:
            return column_words
    if not in_words or "forward" not in meaning.columns:
        return []
    for bracket in words.BRACKET.findall(statement):
        parts = [re.findall(r"[^\W\d]+", part) for part in re.split("[,;]", bracket)]
        parts = [part for part in parts if part and not {"positive", "negative"} & {*part}]
        if len(parts) == 2 and all(words.COLUMN_WORDS.issuperset(part) for part in parts):
            along = [not words.ALONG.isdisjoint(part) for part in parts]
            sides = ["lateral" in part or "sideways" in part for part in parts]
            if along == [not side for side in sides] and sum(along) == 1:
                return ["forward" if one else "lateral" for one in along]
    return []


def _plain(name: str) -> str:
    """Return a column's name without its sign."""
    return name.lstrip(f"{words.MINUS}+ ")


def _turn(side: str, statement: str) -> str:
    """Return the meaning of a curvature, whose positive side is left unless a heading says more."""
    stated = words.POSITIVE_SIDE.search(statement) or words.NEGATIVE_SIDE.search(statement)
    return words.RIGHT_TURN if stated is not None and side == "right" else "curvature"


def _lateral_side(statement: str, meaning: Meaning, negative_side: str) -> str:
    """Return the side to which a column that is only called lateral counts."""
    if (positive := words.POSITIVE_SIDE.search(statement)) is not None:
        return positive[1] or positive[2]
    if negative_side:
        return words.MIRRORED[negative_side]
    return "left" if "left" in meaning.columns else "right"


def _arranged(rows: Rows, columns: Sequence[str], meaning: Meaning) -> tuple[Rows, Times, bool]:
    """Arrange rows in an interface's order and signs; also return times and if rows changed."""
    picked: list[tuple[int, float]] = []
    for column in meaning.columns:
        mirrored = words.MIRRORED.get(column, column)
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
        words.RIGHT_TURN,
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
    if points and (picture := words.PICTURE.search(statement)) is not None:
        return f"the list is in {picture['unit']!r}"
    if points and (stretched := words.SCALED.search(statement)) is not None:
        return f"the list is {stretched.group()!r}"
    if points and (multiple := words.MULTIPLE.search(statement)) is not None and not one.units:
        factor = float(multiple[1]) * words.LENGTHS_M[multiple[2]]
        return (factor, factor), f"{multiple[1]} {multiple[2]}"
    of_axes = (
        dict(words.UNIT_OF_AXIS.findall(statement))
        if points and not words.AXIS.search(statement)
        else {}
    )
    if len({words.LENGTHS_M[unit] for unit in of_axes.values()}) > 1:
        first, second = words.LENGTHS_M[of_axes["x"]], words.LENGTHS_M[of_axes["y"]]
        return (first, second), f"x in {of_axes['x']}, y in {of_axes['y']}"
    stated = {*one.units, *words.UNIT.findall(statement)} - {"s"}
    if "forward" in meaning.columns and len({words.LENGTHS_M.get(unit) for unit in one.units}) > 1:
        return f"the rows are in {' and '.join(sorted(one.units))}"
    stated -= accepted & one.units
    if points:
        units_m: dict[str, float] = words.LENGTHS_M
        wrong = sorted(stated - units_m.keys())
        lengths = {units_m[unit] for unit in stated - set(wrong)}
        if wrong or len(lengths) > 1:
            return f"the list is in {(wrong or sorted(stated))[0]!r}"
        factor = lengths.pop() if lengths else 1.0
        return (factor, factor), ", ".join(sorted(stated))
    scale = 1.0 if words.HUNDREDTHS.search(statement) else meaning.curvature_scale
    speeds = {
        words.SPEEDS_MPS[unit] * meaning.step_s for unit in stated if unit in words.SPEEDS_MPS
    }
    curvatures = {
        words.CURVATURES_PM[unit] * scale for unit in stated if unit in words.CURVATURES_PM
    }
    wrong = sorted(stated - words.SPEEDS_MPS.keys() - words.CURVATURES_PM.keys() - accepted)
    if wrong or len(speeds) > 1 or len(curvatures) > 1:
        return f"the list is in {(wrong or sorted(stated))[0]!r}"
    factors = (speeds.pop() if speeds else 1.0, curvatures.pop() if curvatures else 1.0)
    return factors, ", ".join(sorted(stated))
