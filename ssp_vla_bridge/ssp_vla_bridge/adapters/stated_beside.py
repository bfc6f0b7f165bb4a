"""Statements beside a list of how it is meant: fields of its object, lines of their own.

A key is read by its parts ("sampleRateHz" is sample, rate, hz). All of them must be in the tables
below, so that "headway_s" or "reaction_time" say nothing of the list. A sentence counts if it has
only words of such statements. What names a time, a unit or a frame and can't be read is a problem,
never passed over.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from ssp_vla_bridge.adapters.stated import states_columns
from ssp_vla_bridge.adapters.stated_times import (
    REACHING,
    STATING,
    Beside,
    Raster,
    stated_horizon,
    states_times,
)

_LOOKED_AT = 400
_LONGEST = 200
_KEYED = r"[\"'](?P<key>[\w .\-]{1,40})[\"']\s*:\s*"
_VALUE = (
    r"(?P<value>\"[^\"\n]{0,80}\"|'[^'\n]{0,80}'|\[[^\[\]{}]{0,200}\]|\{[^\[\]{}]{0,200}\}"
    r"|[-+]?\d*\.?\d+(?![\w.])|true\b|false\b)"
)
_FIELD = re.compile(_KEYED + _VALUE)
_ELEMENT = re.compile(r"<(?P<key>[A-Za-z][\w.\-]{0,40})>\s*(?P<value>[^<>\n]{1,80}?)\s*</(?P=key)>")
_TAG = re.compile(
    r"<[A-Za-z][\w.\-]{0,40}((?:\s+[\w.\-]{1,40}\s*=\s*[\"'][^\"'<>\n]{0,80}[\"'])+)\s*>"
)
_ATTRIBUTE = re.compile(r"(?P<key>[\w.\-]{1,40})\s*=\s*(?P<value>[\"'][^\"']{0,80}[\"'])")
_LINE = re.compile(
    r"[ \t]*(?:[-*•][ \t]+)?[*_`]*(?P<key>[A-Za-z][\w .()\-]{0,40}?)[*_`]*\s*[:=][*_`]*\s+"
    r"(?P<value>[^\s{][^\n]{0,120}?)[ \t,;.]*"
)
_SENTENCE_END = re.compile(r"[.!?](?=\s|\Z)|\n")
_PART = re.compile(r"[a-zδ]+|\d+")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_NUMBER = re.compile(r"[-+]?\d*\.?\d+(?:e-?\d+)?")
_OF_CAMERA = re.compile(r"\b(?:frame ?rate|camera|image|frames per second)\b(?!.*\bcoordinates?\b)")
_OBJECT = re.compile(r"\{[^{}]*\}")
_MOST_DEEP = 4  # objects that hold a list
_SPAN = re.compile(r"\d|\b(?:milli)?seconds?\b")
_OF_ANOTHER = re.compile(r"\W*(?:these|those|they)\b")

# Parts of keys: the units of time, what a step or a rate is called, and what may stand beside.
_MILLI = frozenset({"ms", "msec", "msecs", "millis", "millisecond", "milliseconds"})
_SECONDS = frozenset({"s", "sec", "secs", "second", "seconds"})
_HERTZ = frozenset({"hz", "fps", "hertz"})
_STEP = frozenset({"dt", "δt", "interval", "intervals", "period", "cadence", "timestep", "between"})
# A step in time or in space: "spacing".
_STEP_OF_SOME = frozenset({"step", "stepsize", "spacing", "resolution", "sampling", "separation"})
# The first and the last time, an axis and the order of columns, ways of single steps.
_BEGIN = frozenset({"start", "begin", "first", "initial", "0"})
_END = frozenset({"end", "last", "final"})
_AXIS = frozenset({"axis", "direction"})
_COLUMNS = frozenset({"columns", "fields", "axes", "order", "format", "names"})
_OF_COLUMNS = _COLUMNS | frozenset({"column", "coordinate", "coordinates", "axis", "field", "data"})
_STEPWISE = frozenset({"delta", "deltas", "incremental", "differences", "displacements"})
_OF_STEPWISE = frozenset(
    {"is", "are", "as", "to", "use", "uses", "encoded", "previous", "relative"}
)
_SCALE = frozenset({"scale", "scaling"})
# How far a plan reaches; the words that may stand beside "seconds" alone.
_REACH = frozenset({"duration", "span", "timespan", "lookahead", "window", "length", "horizon"})
_REACH_WITH = frozenset({"look", "ahead", "total", "overall"})
_OF_SECONDS = frozenset({"ahead", "future", "total", "num", "number", "n", "of", "planned", "plan"})
_MOST_SECONDS = 10.0  # more may be a clock
# Steps that a unit of length makes ways.
_BY_WAY = frozenset(
    {"spacing", "step", "stepsize", "separation", "sampling", "interval", "between"}
)
_METRES = frozenset({"m", "metre", "metres", "meter", "meters"})
_RATE = frozenset({"rate", "frequency", "freq", "samplerate"})
_TIMES = frozenset(
    {"t", "ts", "time", "times", "timestamp", "timestamps", "stamps", "timesteps", "timestep"}
)
_LISTED = frozenset({"times", "timestamps", "stamps"})
_OF_TIME = frozenset({"time", "temporal", "delta", "t", "sampling", "sample"})
_OF_ROWS = frozenset(
    {"waypoint", "waypoints", "way", "point", "points", "row", "rows", "trajectory", "traj", "path"}
    | {"plan", "planning", "planned", "prediction", "predicted", "output", "future", "position"}
    | {"positions", "sample", "samples", "frame", "frames", "step", "steps", "size", "time"}
    | {"delta", "t", "temporal", "sampling", "model", "relative", "rel", "two", "consecutive"}
    | {"each", "per", "ego", "length", "in", "the", "of", "constant", "update", "axis", "range"}
)
_ALL_OF_TIME = _MILLI | _SECONDS | _HERTZ | _STEP | _STEP_OF_SOME | _RATE | _TIMES | _OF_ROWS
_OF_LENGTH = _OF_ROWS | frozenset(
    {"distance", "distances", "length", "lengths", "coordinate", "coordinates", "coord", "coords"}
    | {"xy", "x", "y", "spatial", "units", "unit"}
)
_OF_FRAME = frozenset(
    {"frame", "frameid", "id", "system", "crs", "coordinate", "coordinates", "coord", "coords"}
    | {
        "reference",
        "ref",
        "origin",
        "trajectory",
        "waypoint",
        "waypoints",
        "path",
        "plan",
        "header",
    }
)
# Values of a frame that is the vehicle's, and of one that isn't.
_OWN_FRAME = frozenset(
    {"ego", "egocentric", "vehicle", "car", "own", "self", "local", "body", "base", "baselink"}
    | {"hero", "relative", "rear", "axle", "bev", "flu", "frd", "rfu", "forward", "vut", "host"}
)
_OTHER_FRAME = frozenset(
    {
        "lidar",
        "velodyne",
        "radar",
        "sensor",
        "map",
        "odom",
        "odometry",
        "world",
        "global",
        "earth",
        "utm",
        "wgs",
        "ecef",
        "enu",
        "ned",
    }
    | {"gps", "geographic", "image", "camera", "pixel", "pixels", "frenet", "polar", "opendrive"}
)
# Units that need no conversion or that the reader of headings knows; any other is a problem.
_UNITS_TEXT = """
m metre metres meter meters si metric mks ft feet foot cm mm km yd yards yard inch inches dm
centimetre centimetres centimeter centimeters kilometre kilometres kilometer kilometers px pixel
pixels cells s mph knots kph kmh degrees deg normalized normalised
"""
_UNITS = frozenset(_UNITS_TEXT.split())
# Values of a unit or frame that name none.
_SAY_NOTHING = frozenset({"default", "none", "null", "auto", "unknown", "standard", "same"})
# Words beside those of times of which a sentence on units, axes or times consists.
_CARRIERS_TEXT = """
i we my our own ego vehicle use used using give given gives list lists listed plan plans planned
planning trajectory trajectories path coordinate coordinates number numbers output following below
above here by note that this these those they all will where so which expressed measured written
stated specified convention system unit units axis axes as on before it distance distances its
right left forward forwards ahead front lateral laterally longitudinal sideways positive negative
pointing facing towards toward rightwards leftwards rightward leftward while with has have ordered
order sorted back listed meant feet foot ft yards yard yd inches cm centimetres centimeters km mm
kilometres kilometers pixels pixel px map world global utm enu ned camera image picture space
corresponds represents covers equals means stands
reference relative spaced sits lies comes later earlier preceding than
three four five six seven eight nine ten half last latest farthest nearest
"""
# Words beside those of horizons of which a sentence on how far a plan reaches consists; sides and
# actions aren't among them: "I plan to move left over the next 4 s".
_OF_PLAN_TEXT = """
i we my our own ego vehicle car self autonomous will here that this these they all it its so
give gives given list lists listed plan plans planned planning trajectory trajectories path paths
route waypoint waypoints way points positions coordinate coordinates output predict predicts below
above following follow follows drive drives driving take takes execute executes reach reaches pass
cover extend extends through current present now safe smooth optimal recommended proposed intended
desired final complete entire whole full corresponding resulting
three four five six seven eight nine ten half
"""
_IN_BRACKETS = re.compile(r"[()\[\]]")
_CARRIERS = STATING | frozenset(_CARRIERS_TEXT.split())
_OF_PLAN = REACHING | frozenset(_OF_PLAN_TEXT.split())
_WORDS = re.compile(r"[^\W\d_]+(?:_[^\W\d_]+)*")


def read_beside(
    text: str, place: tuple[int, int, int, int], rows: int, raster: Raster, points: bool
) -> Beside:
    """Return what stands beside a list and says how it is meant.

    Args:
        text: the answer's.
        place: offsets behind the list before, of this list, behind its last row, and of the next.
        rows: how many it has.
        raster: of the interface.
        points: whether its rows are places, whose units and axes sentences may state.
    """
    begin, start, end, stop = place
    after_list = begin > max(0, start - _LOOKED_AT)
    begin, last = max(begin, start - _LOOKED_AT), min(stop, end + _LOOKED_AT)
    words, problem, of_times = "", "", ""
    for key, value in _fields(text, begin, start, end, last):
        statement = _of_field(key, value, rows, raster)
        words += statement.words
        problem, of_times = problem or statement.problem, of_times or statement.times_problem
    for sentence in _sentences(text[begin:start], text[end:last], after_list, stop < len(text)):
        if states_times(sentence) or (points and states_columns(sentence)):
            words += f" ({_IN_BRACKETS.sub(',', sentence)})"
        elif horizon := _horizon(sentence):
            words += f" ({horizon})"
    return Beside(words.lower(), problem if points else "", of_times)


def _fields(text: str, begin: int, start: int, end: int, last: int) -> Iterator[tuple[str, str]]:
    """Yield keys and values beside a list, of JSON, XML and lines of their own."""
    opened, closed = _opening_brace(text, start), _closing_brace(text, end)
    if opened >= 0 or re.search(r"[\"']\s*:\s*\Z", text[begin:start]):
        before = text[opened if opened >= 0 else begin : start]
        behind = text[end:closed]
        for _ in range(_MOST_DEEP):
            if opened < 0 or (outer := _opening_brace(text, opened)) < 0:
                break
            before = _OBJECT.sub(" ", text[outer:opened]) + before
            after = _closing_brace(text, closed + 1)
            behind += _OBJECT.sub(" ", text[closed + 1 : after])
            opened, closed = outer, after
        for part in (before, behind):
            yield from _of_objects(part)
        return
    for part in (text[begin:start], text[end:last]):
        yield from ((one["key"], one["value"]) for one in _ELEMENT.finditer(part))
    for tag in _TAG.finditer(text, begin, start):
        yield from ((one["key"], one["value"]) for one in _ATTRIBUTE.finditer(tag[1]))
    above = text[begin:start].split("\n")
    labels = [line for line in above if line.strip(" \t[({-")]
    depth = _indent(labels[-1]) if labels else 0
    for line in (*above, *text[end:last].split("\n")[1:]):
        match = _LINE.fullmatch(line)
        if match is not None and _indent(line) <= depth:
            yield match["key"], match["value"]


def _of_objects(part: str) -> Iterator[tuple[str, str]]:
    """Yield the fields of a part of an object, and those of the objects in it."""
    for one in _FIELD.finditer(part):
        yield one["key"], one["value"]
        if one["value"].startswith("{"):
            yield from ((two["key"], two["value"]) for two in _FIELD.finditer(one["value"]))


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip(" \t"))


def _opening_brace(text: str, start: int) -> int:
    """Return the offset of the brace that opens the object an offset stands in, -1: none near."""
    depth = 0
    for at in range(start - 1, max(-1, start - _LOOKED_AT), -1):
        depth += {"}": 1, "{": -1}.get(text[at], 0)
        if depth < 0:
            return at
    return -1


def _closing_brace(text: str, end: int) -> int:
    """Return the offset of the brace that closes the object an offset stands in, or how far."""
    depth = 0
    for at in range(end, min(len(text), end + _LOOKED_AT)):
        depth += {"{": 1, "}": -1}.get(text[at], 0)
        if depth < 0:
            return at
    return min(len(text), end + _LOOKED_AT)


def _sentences(before: str, behind: str, after_list: bool, list_follows: bool) -> list[str]:
    """Return the sentences beside a list that have no word but those of statements or horizons.

    Args:
        before: the text before the list.
        behind: the text behind it.
        after_list: whether another list ends where ``before`` begins.
        list_follows: whether another one begins where ``behind`` ends.
    """
    above = [one.strip() for one in _SENTENCE_END.split(before.lower())]
    sentences = [one for one in above if _is_statement(one)]
    if after_list:
        sentences = [one for one in sentences if _OF_ANOTHER.match(one) is None]
    below = [
        one.strip() for one in _SENTENCE_END.split(behind.lower()) if any(map(str.isalnum, one))
    ]
    right_behind = next((i for i, one in enumerate(below) if not _is_statement(one)), len(below))
    if right_behind < len(below) or not list_follows:
        sentences += below[:right_behind]
    return sentences


def _is_statement(sentence: str) -> bool:
    words = _WORDS.findall(sentence)
    if not words or len(sentence) > _LONGEST or _OF_CAMERA.search(sentence) is not None:
        return False
    return _CARRIERS.issuperset(words) or _horizon(sentence) != ""


def _horizon(sentence: str) -> str:
    """Return the horizon of a sentence that is on nothing else, empty: it states none."""
    return stated_horizon(sentence) if _OF_PLAN.issuperset(_WORDS.findall(sentence)) else ""


def _of_field(key: str, value: str, rows: int, raster: Raster) -> Beside:
    """Return what one field says of a list."""
    parts = _PART.findall(_CAMEL.sub(" ", key).lower())
    key_words = set(parts)
    plain = value.strip("{[]\"' \t").lower()
    plain = re.sub(r"[\"']", "", plain)
    if not parts or not plain:
        return Beside()
    if not key_words.isdisjoint({"unit", "units"}):
        return _of_units(key_words, value, plain)
    if (reach := _of_reach(key_words, value, plain, rows, raster)) is not None:
        return reach
    if (by_way := _of_way(key_words, plain)) is not None:
        return by_way
    if (bound := _of_bound(key_words, plain)) is not None:
        return bound
    if value in ("true", "false"):
        return _of_flag(key_words, plain)
    if key_words <= _OF_FRAME and not key_words.isdisjoint({"frame", "frameid", "system", "crs"}):
        return _of_frame(key_words, key, plain)
    if not key_words.isdisjoint(_COLUMNS) and key_words <= _OF_COLUMNS | _OF_ROWS:
        return Beside(f"; {key} {plain}; order {plain}")
    axis = key_words - _AXIS
    if axis in ({"x"}, {"y"}) and _NUMBER.fullmatch(plain) is None:
        return Beside(f" ({''.join(axis)} {plain})")
    if not key_words.isdisjoint(_SCALE) and key_words <= _SCALE | _OF_LENGTH | {"factor"}:
        scaled = _NUMBER.fullmatch(plain) is not None and float(plain) != 1.0
        return Beside(problem=f"the list is scaled by {plain}" if scaled else "")
    if not key_words <= _ALL_OF_TIME or key_words == {"frame", "rate"}:
        return Beside()
    return _of_time(key_words, key, value, plain, rows, raster)


def _of_bound(key_words: set[str], plain: str) -> Beside | None:
    """Return the time of the first or last row that a field states; None: it states none."""
    rest = key_words - _OF_ROWS - _SECONDS - _MILLI - _TIMES
    is_first = rest <= _BEGIN
    if (
        not rest
        or not (is_first or rest <= _END)
        or key_words.isdisjoint(_TIMES | _SECONDS | _MILLI)
    ):
        return None
    number = re.sub(r"\s*(?:s|secs?|seconds?)$", "", plain)
    if _NUMBER.fullmatch(number) is None:
        return Beside()
    time_s = float(number) * (0.001 if key_words & _MILLI else 1.0)
    if not 0.0 < time_s <= _MOST_SECONDS:
        return Beside()
    return Beside(f" (first point at t = {time_s:g} s)" if is_first else f" (horizon {time_s:g} s)")


def _of_flag(key_words: set[str], plain: str) -> Beside:
    """Return what a field that is true or false says: that rows are ways of single steps."""
    stepwise = not key_words.isdisjoint(_STEPWISE) or key_words >= {"relative", "previous"}
    if plain == "true" and stepwise and key_words <= _STEPWISE | _OF_STEPWISE | _OF_ROWS:
        return Beside(problem="the list gives the ways of single steps")
    return Beside()


def _of_units(key_words: set[str], value: str, plain: str) -> Beside:
    words = set(_WORDS.findall(plain))
    of_time = key_words - {"unit", "units"}
    if of_time == {"time"}:
        if words <= _SECONDS:
            return Beside()
        milli = words <= _MILLI
        problem = "" if milli else f"the unit of its times is {plain!r}"
        return Beside("; in ms" if milli else "", times_problem=problem)
    if not key_words <= _OF_LENGTH:
        return Beside()
    unknown = value[:1] != "{" and len(words) == 1 and words.isdisjoint(_UNITS | _SAY_NOTHING)
    problem = f"the list's unit is {plain!r}" if unknown else ""
    return Beside(f"; units {plain} ({plain})", problem)


def _of_reach(
    key_words: set[str], value: str, plain: str, rows: int, raster: Raster
) -> Beside | None:
    """Return what a field says of how far a plan reaches; None: it is no such field.

    A number without a unit is a horizon in seconds, unless it counts the rows; of a duration it
    says nothing.
    """
    number = _NUMBER.fullmatch(plain)
    if "horizon" not in key_words and value.startswith("["):
        return None
    if key_words & {"seconds", "secs"} and key_words - _SECONDS <= _OF_SECONDS:
        if number is None or not raster.step_s < float(plain) <= _MOST_SECONDS:
            return Beside()
        return Beside(f" (horizon {plain} s)")
    is_total = "total" in key_words and "time" in key_words
    if key_words.isdisjoint(_REACH) and not is_total and not key_words >= {"look", "ahead"}:
        return None
    if not key_words - _REACH - _REACH_WITH <= _ALL_OF_TIME:
        return Beside() if "horizon" in key_words else None
    unit = "ms" if key_words & _MILLI else "s" if key_words & _SECONDS else ""
    if number is not None and not unit:
        if "horizon" not in key_words or float(plain) in (rows, raster.rows, rows + 1):
            return Beside()
        unit = "s"
    return Beside(f" (horizon {plain} {unit})")


def _of_way(key_words: set[str], plain: str) -> Beside | None:
    """Return the way between rows that a field states; None: it states none."""
    rest = key_words - _METRES
    if rest.isdisjoint(_BY_WAY) or not rest <= _BY_WAY | _OF_ROWS | {"distance"}:
        return None
    number = plain if key_words & _METRES else re.sub(r"\s*(?:m|met(?:er|re)s?)$", "", plain)
    if _NUMBER.fullmatch(number) is None or not (key_words & _METRES or number != plain):
        return None
    return Beside(f" (every {number} m)")


def _of_frame(key_words: set[str], key: str, plain: str) -> Beside:
    words = set(_WORDS.findall(plain.replace("_", " ").replace("/", " ")))
    if any(character.isdigit() for character in plain) and words.isdisjoint(_OTHER_FRAME):
        return Beside()  # the number of a picture
    if words & _OTHER_FRAME and not words & _OWN_FRAME:
        return Beside(problem=f"the list is in the frame {plain!r}")
    id_words = {"id", "frameid"} & key_words
    if id_words and words.isdisjoint(_OWN_FRAME | _SAY_NOTHING):
        return Beside(problem=f"the list is in the frame {plain!r}")
    return Beside(f"; {key} {plain}; {plain} frame")


def _of_time(
    key_words: set[str], key: str, value: str, plain: str, rows: int, raster: Raster
) -> Beside:
    unit = "ms" if key_words & _MILLI else "s" if key_words & _SECONDS else ""
    if value.startswith("[") or (not key_words.isdisjoint(_LISTED) and "," in plain):
        return _of_array(key_words, key, plain, unit, rows, raster)
    if "range" in key_words and not key_words.isdisjoint(_TIMES):
        return Beside(f" (t = {plain} {unit})")
    is_rate = bool(key_words & _HERTZ) or (bool(key_words & _RATE) and len(key_words) > 1)
    is_rate = is_rate or not key_words.isdisjoint({"frequency", "freq", "samplerate"})
    is_step = not is_rate and (bool(key_words & _STEP) or key_words >= {"delta", "t"})
    some = not (is_rate or is_step) and bool(key_words & _STEP_OF_SOME)
    if some and (
        unit or (key_words & _STEP_OF_SOME and key_words & (_OF_TIME - {"sampling", "sample"}))
    ):
        is_step, some = True, False
    number = _NUMBER.fullmatch(plain)
    if number is not None and (is_rate or is_step):
        return Beside(f" ({plain} hz)" if is_rate else f" (dt {plain} {unit})")
    if some and number is not None:
        # A count of a step, "step": 2, says nothing; another span may be one of space.
        if key_words <= {"step", "steps"} and float(plain).is_integer():
            return Beside()
        if abs(float(plain) - raster.step_s) < 1e-9:
            return Beside()
        return Beside(times_problem=f"the unit of {key!r}: {plain} isn't stated")
    if not (is_rate or is_step or some) or _SPAN.search(plain) is None:
        return Beside()
    words = plain if is_rate else f"dt {plain}"
    if _CARRIERS.issuperset(_WORDS.findall(plain)) and states_times(words):
        return Beside(f" ({words})")
    if some and not states_times(f"spacing {plain}"):
        return Beside()
    return Beside(times_problem=f"the times can't be read that {key!r} states: {plain!r}")


def _of_array(
    key_words: set[str], key: str, plain: str, unit: str, rows: int, raster: Raster
) -> Beside:
    """Return the times that a field states for each row."""
    if key_words.isdisjoint(_TIMES | _SECONDS | _MILLI):
        return Beside()
    problem = Beside(times_problem=f"the times can't be read that {key!r} states: {plain[:60]!r}")
    entries = [
        re.sub(r"^t\s*[+=]\s*|\s*(?:s|secs?|seconds?)$", "", one.strip())
        for one in plain.split(",")
    ]
    if not all(_NUMBER.fullmatch(one) for one in entries):
        return problem
    values = [float(one) for one in entries]
    if len(values) == rows + 1 and values[0] == 0:
        values, entries = values[1:], entries[1:]
    if len(values) != rows:
        span = len(values) == 2
        return Beside(f" (t = {entries[0]} to {entries[1]} {unit or 's'})") if span else problem
    counted = not key_words.isdisjoint({"steps", "timesteps", "step", "timestep"}) and not unit
    first = values[0]
    if counted and first in (0, 1) and values == [first + k for k in range(rows)]:
        if abs(raster.step_s - 1.0) < 1e-9 or rows < 2:
            return Beside()
        return Beside(times_problem=f"{key!r} may count steps or seconds: {plain[:60]!r}")
    return Beside(f" (times {', '.join(entries)} {unit})")
