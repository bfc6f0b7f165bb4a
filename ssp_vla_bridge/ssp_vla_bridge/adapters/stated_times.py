"""The times of a list's rows that its heading states (METHOD 5.4b).

Read are times themselves, a first and a last one, the time of the first row, and a step or rate.
How far a plan reaches ("over the next 6 s") is the time of its last row, by one step, or the
interface's horizon. What states times in any other way is a problem, never passed over, and so are
rows that are spaced by their way ("every 1 m").
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_vla_bridge.adapters.plan_label import PLAN_WORDS

_NUMBER = r"\d*\.?\d+"
_UNIT = r"(?:ms|msecs?|milliseconds?|s|secs?|seconds?)"
_ROW = r"(?:(?:way-?)?points?|rows?|pairs?|samples?|positions?|poses?|steps?|entr(?:y|ies)|values?)"
_LISTED = (  # "1, 2, 3", "1 s, 2 s and 3", "1 s, t = 2 s"
    rf"{_NUMBER}(?:\s*{_UNIT}?\s*(?:,\s*and|,|and|/)\s*(?:t\s*[=+]\s*)?{_NUMBER})+"
)
_TIMES = re.compile(
    rf"(?:\bt\s*[=+]|\btimes?(?:_?stamps?)?(?:_m?s)?\s*(?:[:=]|are|at)?|\bat)\s*[\[(]?"
    rf"(?P<timed>{_LISTED})"
    rf"[\])]?\s*(?P<unit>{_UNIT})\b"
    rf"|\b(?P<in>milli)?seconds\s*:?\s*[\[(]?(?P<named>{_LISTED})"
    rf"|\b(?:t\s*=|times?(?:_?stamps?|_s)?\s*[:=]?)\s*[\[(]?(?P<bare>{_LISTED})(?![\w.])"
)
_RANGE = re.compile(
    rf"(?P<key>\bt\s*=\s*|\bseconds?\s+|\btimes?(?:_?stamps?)?\s*(?:from|[:=])?\s*)?(?<![\w.\-])"
    rf"(?P<first>{_NUMBER})\s*(?P<of>{_UNIT}\b)?\s*(?:to|until|through|–|-|\.{{2,3}}|…)\s*"
    rf"(?:t\s*=\s*)?(?P<last>{_NUMBER})(?!\.?\d)\s*(?P<unit>{_UNIT}\b)?"
)
_FIRST = re.compile(
    rf"\bfirst\s+(?:{_ROW}|one)\s*(?:(?:is|lies|stands|comes|at|after|in|for|:|=|\()\s*)*"
    rf"(?:\bt\s*=\s*(?P<named>{_NUMBER})\s*(?P<of>{_UNIT})?"
    rf"|(?P<timed>{_NUMBER})\s*(?P<unit>{_UNIT}))\b"
)
_BEGINS = re.compile(
    rf"\b(?:t_?0\s*=|(?:start|begin)(?:s|ing|ning)?\s+(?:at|from|with)\s+t\s*=)\s*({_NUMBER})"
    rf"\s*({_UNIT})?\b"
)
_RATE = re.compile(
    rf"(?<![\w.])(?P<rate>{_NUMBER})\s*(?:hz|fps|frames per second|{_ROW} (?:per|a) second)\b"
)
# What states the step between rows, before it and behind it.
_STEP = re.compile(
    r"(?:\bevery|\bsteps? of|δt\s*[:=]?|\b(?:dt|delta[ _]?t)\s*[:=]?|\bintervals?(?: of|:|=)?"
    r"|\bperiods?(?: of|:|=)?|\bcadence(?: of|:|=)?|\bresolution(?: of|:|=)?"
    r"|spac(?:ed|ing)(?: by| of|:|=)?"
    r"|\bseparat(?:ed|ion)(?: by| of|:|=)?|\btime ?steps?(?: size)?(?: of|:|=| is)?"
    r"|\bsteps?(?: size)?(?::|=| is)?"
    r"|\bsampl(?:ing|ed)(?: (?:time|interval|period|step))?(?: of| at| every|:| =)?"
    rf"|\b(?:{_ROW}|one),? (?:per|each|after)"
    rf"|\b(?:each|every|one) {_ROW} (?:is|equals|covers|represents|means|corresponds to|stands for)"
    rf"|\bbetween (?:\w+ ){{0,2}}(?:{_ROW}|them)(?: of|:|=| is)?)"
    rf"\s*(?P<before>{_NUMBER})\s*(?P<unit>{_UNIT})\b"
    rf"|(?<![\w.])(?P<behind>{_NUMBER})[ -]*(?P<of>{_UNIT})[ -]+(?:time[ -])?"
    r"(?:steps?|apart|intervals?|spacing|spaced|increments?|periods?|cadence|resolution|each\b"
    rf"|(?:per|for each|for every) (?:{_ROW})|(?:between|from) (?:\w+ ){{0,2}}(?:{_ROW}|them|one)"
    rf"|(?:after|later than|from) the (?:(?:{_ROW}|one) before|(?:previous|preceding) "
    rf"(?:{_ROW}|one)))"
    rf"|(?:(?:δt|\b(?:dt|delta[ _]?t))\s*[:=]?|\btime ?step\s*[:=])\s*(?P<bare>{_NUMBER})"
    r"(?!\s*[:→]|[\w.])"
    r"|\bstep(?: size)?\s*[:=]?\s*(?P<decimal>\d*\.\d+)(?=\s*[,;)\]])"
    rf"|\b(?:{_ROW}|one),?(?: for)? (?:per|every|each) (?P<half>half[- ](?:a )?)?(?P<word>second)\b"
)
_COUNTS = ("two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
# Spans of time in words: "one second apart", "at half-second steps".
_IN_WORDS = tuple(
    (re.compile(rf"\b(?:{words})(?:[- ]| of )(?:a )?seconds?\b"), f"{number} s")
    for words, number in (
        ("(?:a |one[- ])?half(?: a)?", "0.5"),
        ("(?:a |one[- ])?quarter", "0.25"),
        ("(?:a |one[- ])?tenth", "0.1"),
        ("one(?! (?:per|every|each|for))", "1"),
        *((word, str(number)) for number, word in enumerate(_COUNTS, 2)),
        ("a(?= seconds? (?:apart|steps?|intervals?|spacing|between))", "1"),
    )
)
_IS_STEP = r"[ -]*(?:steps?|apart|intervals?|spac|increments?|each|between|per|resolution|cadence)"
# How far a plan reaches.
_HORIZON = re.compile(
    r"\b(?:next|over|for|horizon|within|future|coming|following|total|duration|until|up to|lasting"
    r"|length|long|covering|covers?|spanning|(?<!step )(?<!interval )spans?"
    r"|(?:h|t_?(?:h|f|end|max|total|horizon))(?=\s*[:=≈]))\b"
    r"(?:\W+(?:the|a|of|is|next|coming|following|future|time|horizon|period|window"
    rf"|span|about|approximately))*\W*(?P<behind>{_NUMBER})\W?(?P<unit>{_UNIT})\b(?!{_IS_STEP})"
    rf"|(?<![\w.])(?P<before>{_NUMBER})\W?(?P<of>{_UNIT})[ -]"
    r"(?:horizon|trajector\w+|plan\w*|ahead|long|total|windows?|look\w*|future|in (?:all|total)"
    r"|into|of (?:driving|motion))\b"
    rf"|\b(?:last|final)\s+(?:{_ROW}|one)\s*(?:(?:is|lies|stands|at|t|[=:(])\s*)*"
    rf"(?P<last>{_NUMBER})\s*(?P<at>{_UNIT})\b"
)
# The way between rows, which says nothing of their times.
_WAY = rf"{_NUMBER}\s*(?:m|met(?:er|re)s?|cm|ft|feet)\b"
_BY_WAY = re.compile(
    rf"\b(?:every|spac(?:ed|ing)|steps? of|intervals?)(?:\s*(?:by|of|at|[:=]))*\s*{_WAY}"
    rf"|(?<![\w.]){_WAY}[ -](?:apart|spacing|spaced|intervals?|steps?)\b"
)
# Words of which a statement of times consists; a remark has others: "(headway 2 s)".
_STATING_TEXT = """
a an the one two and then of in at to from is are be each per every for with between after
another until through first last next previous later earlier consecutive successive adjacent
starting start begins beginning t dt δ δt t0 ts delta time times timestamp timestamps timestep
timesteps stamp stamps step steps size period periods interval intervals spacing spaced rate
sampling sampled sample samples frequency cadence resolution fps hz khz ms msec msecs s sec secs
second seconds millisecond milliseconds minute minutes min frame frames point points waypoint
waypoints way row rows pair pairs position positions entry entries value values apart constant
fixed uniform equal equally evenly m metre metres meter meters x y
"""
STATING = frozenset(_STATING_TEXT.split())
# Words of which a statement of a horizon consists as well.
REACHING = STATING | frozenset(
    {"horizon", "over", "within", "future", "coming", "following", "total", "duration", "up"}
    | {"lasting", "length", "long", "ahead", "look", "lookahead", "in", "all", "into", "window"}
    | {"covering", "covers", "spanning", "span", "planning", "prediction", "predicted", "about"}
    | {"h", "th", "t_h", "tf", "t_f", "tend", "t_end", "tmax", "t_max", "t_total", "t_horizon"}
)
_HORIZON_LINE = re.compile(r"^\W*(?:\w+ ){0,2}horizon\b[^\n]*", re.MULTILINE)
_WORDS = re.compile(r"[^\W\d_]+(?:_[^\W\d_]+)*")
_TIMED = re.compile(
    rf"(?<![\w.]){_NUMBER}\s*(?:{_UNIT}|k?hz|fps|min(?:utes?)?)\b"
    r"|\b(?:dt|δt|periods?|intervals?|spacing|sampling|cadence|timestamps?|rate|frequency)\b\W*\d"
)
_BRACKET = re.compile(r"[(\[]([^()\[\]]*)[)\]]")
_PLAN = re.compile(rf"\b{PLAN_WORDS}\b")
_POINTS = re.compile(rf"\b(?:{PLAN_WORDS}|points?|positions?|coordinates|output|prediction)\b")
# "The next 6 s of my trajectory", "6 s trajectory".
_NAMED_BY_HORIZON = re.compile(
    rf"\b(?:next|coming|following)\W+{_NUMBER}\W?{_UNIT} (?:of|for) (?:\w+ )?{PLAN_WORDS}\b"
    rf"|(?<![\w.]){_NUMBER}\W?{_UNIT}[ -]{PLAN_WORDS}\b"
)
_CLAUSE_END = re.compile(r"[,;:\n]|(?<!\.)\.(?![\d.])")
_ONLY_SPAN = re.compile(rf"\W*(?P<span>{_NUMBER})\s*(?:s|secs?|seconds?)\W*")
# A unit of times that no number stands before: "(t in ms, x, y)".
_IN_MS = re.compile(r"(?<![\d.])(?<!\d )(?<![a-z])(?:ms|msecs?|milliseconds?)\b")
# Times in an unknown unit that lie later than this, or than so many horizons, aren't seconds.
_LATEST_S = 10.0
_HORIZONS = 4.0
_AT_ORIGIN_M = 1e-6
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Raster:
    """The rows that an interface asks for.

    Args:
        rows: how many.
        step_s: between them, and from t = 0 to the first one.
    """

    rows: int
    step_s: float

    @property
    def horizon_s(self) -> float:
        """The time of the last row, s."""
        return self.rows * self.step_s


@dataclass(frozen=True)
class Times:
    """The times of a list's rows.

    Args:
        values: one for each row; empty where none are stated.
        has_unit: whether they are seconds for certain.
        problem: why stated times aren't known, empty where they are or where none are stated.
    """

    values: tuple[float, ...] = ()
    has_unit: bool = False
    problem: str = ""


@dataclass(frozen=True)
class Beside:
    """The statements beside a list: fields of its object, lines of their own.

    Args:
        words: as a heading would have them, in lower case.
        problem: why its frame or units aren't known, empty where they are.
        times_problem: why stated times aren't known, which counts where no others are stated.
    """

    words: str = ""
    problem: str = ""
    times_problem: str = ""


def states_times(words: str) -> bool:
    """Tell whether words in lower case state the times of rows in a way that is read."""
    for pattern, number in _IN_WORDS:
        words = pattern.sub(number, words)
    return any(one.search(words) for one in (_TIMES, _FIRST)) or _step(words)[0] is not None


def stated_horizon(sentence: str) -> str:
    """Return the horizon that a sentence in lower case states of a plan, as a heading would.

    It names the plan, or has no words but those of the horizon; empty: it states none.
    """
    for pattern, number in _IN_WORDS:
        sentence = pattern.sub(number, sentence)
    match = _HORIZON.search(sentence)
    if match is None:
        return ""
    rest = sentence[: match.start()] + sentence[match.end() :]
    if "horizon" not in sentence and _POINTS.search(sentence) is None and _WORDS.search(rest):
        return ""
    last, unit = _reach(match)
    return f"horizon {last:g} {unit}"


def in_seconds(times: Times, heading: str, raster: Raster) -> Times:
    """Return times in seconds, or say why their unit isn't known.

    Args:
        times: as the list or its heading states them.
        heading: in lower case.
        raster: of the interface; its horizon bounds what can be seconds.
    """
    values = times.values
    if not values or times.has_unit:
        return times
    if _IN_MS.search(heading) is not None:
        return Times(tuple(0.001 * value for value in values), has_unit=True)
    if values[0] > _LATEST_S or max(values) > max(_LATEST_S, _HORIZONS * raster.horizon_s):
        last = f"the last one is {max(values):g}"
        return Times(problem=f"its times have no unit and can't be seconds: {last}")
    return times


def heading_times(heading: str, rows: Sequence[Sequence[float]], raster: Raster) -> Times:
    """Read the times that a heading states for a list's rows.

    Args:
        heading: in lower case.
        rows: the list's.
        raster: of the interface.
    """
    for words, number in _IN_WORDS:
        heading = words.sub(number, heading)
    count = len(rows)
    listed = _TIMES.search(heading)
    if listed is not None:
        numbers_text = listed["timed"] or listed["named"] or listed["bare"]
        values = tuple(float(value) for value in re.findall(_NUMBER, numbers_text))
        if len(values) == count:
            unit = listed["unit"] or (f"{listed['in'] or ''}s" if listed["named"] else "")
            return _scaled(values, unit)
    step, unit = _step(heading)
    first = _first(heading)
    if step is None and first is None:
        ranged = _ranged(heading, rows, raster)
        if ranged.values or ranged.problem:
            return ranged
    starts_at_origin = _is_origin(rows)
    if first is not None:
        of_row, first_s = first
        if of_row or first_s or starts_at_origin:
            return _from_first(first_s, step, unit, count, raster)
    if step is None:
        return Times(problem=_unread(heading, count, raster))
    scaled = _scaled((step,), unit)
    step_s = scaled.values[0]
    if (ranged_s := _range_of(heading, count, step_s)) is not None:
        return Times(tuple(ranged_s + k * step_s for k in range(count)), scaled.has_unit)
    whole = step_s > 0 and abs(raster.horizon_s / step_s + 1 - count) < _TOLERANCE
    begin = 0 if starts_at_origin and whole else 1
    return Times(tuple(step_s * (k + begin) for k in range(count)), scaled.has_unit)


def _scaled(values: tuple[float, ...], unit: str) -> Times:
    factor = 0.001 if unit.startswith(("ms", "milli")) else 1.0
    return Times(tuple(factor * value for value in values), unit != "")


def _is_origin(rows: Sequence[Sequence[float]]) -> bool:
    return bool(rows) and all(abs(value) <= _AT_ORIGIN_M for value in rows[0])


def _step(heading: str) -> tuple[float | None, str]:
    """Return the step that a heading states, and its unit; None: it states none."""
    free = _HORIZON.sub(" ", heading)
    step = _STEP.search(free)
    rate = _RATE.search(free)
    if rate is not None and (step is None or step["bare"] or rate.start() < step.start()):
        rate_hz = float(rate["rate"])
        return (1.0 / rate_hz if rate_hz > 0 else float("nan")), "s"
    if step is None:
        return None, ""
    if step["word"]:
        return (0.5 if step["half"] else 1.0), "s"
    if step["bare"] or step["decimal"]:
        return float(step["bare"] or step["decimal"]), ""
    return float(step["before"] or step["behind"]), step["unit"] or step["of"]


def _first(heading: str) -> tuple[bool, float] | None:
    """Return if a heading names the first row, and the time that it states for it, s."""
    match = _FIRST.search(heading)
    if match is not None:
        time_text, unit = match["named"] or match["timed"], match["of"] or match["unit"]
        return True, _scaled((float(time_text),), unit or "s").values[0]
    match = _BEGINS.search(heading)
    if match is None:
        return None
    return False, _scaled((float(match[1]),), match[2] or "s").values[0]


def _from_first(first_s: float, step: float | None, unit: str, count: int, raster: Raster) -> Times:
    if step is None:
        if first_s and abs(first_s - raster.step_s) > _TOLERANCE:
            return Times(problem=f"its first row is at {first_s:g} s, and the step isn't stated")
        step, unit = raster.step_s, "s"
    scaled = _scaled((step,), unit)
    values = tuple(first_s + k * scaled.values[0] for k in range(count))
    return Times(values, scaled.has_unit)


def _range_of(heading: str, count: int, step_s: float) -> float | None:
    """Return the first time of a range that so many rows fill at a step; None: there is none."""
    for match in _RANGE.finditer(heading):
        unit = match["unit"] or match["of"] or ("s" if match["key"] else "")
        first, last = _scaled((float(match["first"]), float(match["last"])), unit).values
        if unit and first > 0 and abs(first + (count - 1) * step_s - last) < _TOLERANCE * count:
            return first
    return None


def _ranged(heading: str, rows: Sequence[Sequence[float]], raster: Raster) -> Times:
    """Read "seconds 1 to 6"; from 0 on it is the time that the plan covers."""
    count = len(rows)
    for match in (one for part in _statements(heading) for one in _RANGE.finditer(part)):
        key = match["key"] or ""
        unit = match["unit"] or match["of"] or ("s" if key.startswith("second") else "")
        if not unit and not key:
            continue
        scaled = _scaled((float(match["first"]), float(match["last"])), unit)
        first, last = scaled.values
        if not 0 <= first < last or count < 2 or (first == 0 and not _is_origin(rows)):
            continue
        for step in (first, raster.step_s) if first else (last / (count - 1),):
            if abs(first + (count - 1) * step - last) < _TOLERANCE * count:
                values = tuple(first + k * step for k in range(count))
                return Times(values, scaled.has_unit)
        return Times(problem=f"{count} rows from {first:g} to {last:g}: the step isn't known")
    return Times()


def _statements(heading: str, words: frozenset[str] = STATING) -> list[str]:
    """Return the brackets of a heading, and clauses behind its plan's name, that speak of times.

    Args:
        heading: in lower case.
        words: of which they consist.
    """
    rest = _BRACKET.sub(" , ", heading)
    plans = list(_PLAN.finditer(rest))
    clauses = _CLAUSE_END.split(rest[plans[-1].end() :]) if plans else []
    parts = (*_BRACKET.findall(heading), *clauses)
    return [part for part in parts if words.issuperset(_WORDS.findall(part))]


def _other_horizon(heading: str, count: int, raster: Raster) -> str:
    """Name a horizon that is neither that of the rows nor the interface's, else nothing."""
    parts = (*_statements(heading, REACHING), *_HORIZON_LINE.findall(heading))
    phrases = [match.group() for match in _NAMED_BY_HORIZON.finditer(heading)]
    for part in (*parts, *phrases):
        match = _HORIZON.search(part)
        if match is None:
            continue
        if _is_other(*_reach(match), count, raster):
            return match.group()
    return ""


def _reach(match: re.Match[str]) -> tuple[float, str]:
    """Return the time and the unit of a horizon."""
    time_text = match["behind"] or match["before"] or match["last"]
    return float(time_text), match["unit"] or match["of"] or match["at"]


def _is_other(last: float, unit: str, count: int, raster: Raster) -> bool:
    """Tell whether a plan's end is neither that of its rows, by one step, nor the interface's."""
    horizon_s = _scaled((last,), unit).values[0]
    of_rows = abs(horizon_s - count * raster.step_s) <= raster.step_s + _TOLERANCE
    return not of_rows and abs(horizon_s - raster.horizon_s) > _TOLERANCE


def _unread(heading: str, count: int, raster: Raster) -> str:
    """Say what a heading states of times that isn't read, empty where that is nothing."""
    if other := _other_horizon(heading, count, raster):
        return f"the list's times are unknown: {count} rows for {other!r}"
    for part in _statements(heading):
        if (by_way := _BY_WAY.search(part)) is not None:
            return f"the list's times are unknown: {by_way.group()!r}"
        span = _ONLY_SPAN.fullmatch(part)
        if span is not None and abs(float(span["span"]) - count * raster.step_s) <= raster.step_s:
            continue
        ranged = _RANGE.search(part)
        if ranged is not None and float(ranged["first"]) == 0:
            unit = ranged["unit"] or ranged["of"] or ("s" if ranged["key"] else "")
            if unit and _is_other(float(ranged["last"]), unit, count, raster):
                return f"the list's times are unknown: {count} rows for {ranged.group()!r}"
            continue
        if (match := _TIMED.search(_HORIZON.sub(" ", part))) is not None:
            return f"the list's times are unknown: {match.group()!r}"
    return ""
