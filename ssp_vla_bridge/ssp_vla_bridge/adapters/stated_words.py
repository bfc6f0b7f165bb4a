"""Words and units in which answers state axes, order, units and frames (METHOD 5.4b)."""

from __future__ import annotations

import math
import re

DIRECTIONS = {
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
NAMES = {
    **DIRECTIONS,
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
_DIRECTION = "|".join(sorted(DIRECTIONS, key=len, reverse=True))
AXIS = re.compile(
    r"\b([xyz])\b[- ]?(?:axis)?"
    r"(?:\s|=|:|\+|→|is|are|points?|pointing|towards?|to|for|as|the|positive)*"
    rf"\b({_DIRECTION})\b"
)
AXIS_BEHIND = re.compile(rf"\b({_DIRECTION})\b\s*(?:=|is|:)?\s*\(?\b([xyz])\b")
MINUS = "-\u2212\u2013"
_COLUMN = rf"((?:(?<!\w)[{MINUS}+]\s?)?[^\W\d]+)(?: angle| rate)?"
_UNIT_BEHIND = (
    r"(?:\s*[\[(][^\])]*[\])]|\s+(?:in\s+)?(?:m|met(?:er|re)s?|ft|feet|cm|km|(?:k?m|ft)/[sh]|mph|1/m"
    r"|rad/m|m\^-1|s|ms|seconds?)(?![\w/]))?"
)
TUPLE = re.compile(
    rf"[\[(<]\s*{_COLUMN}{_UNIT_BEHIND}\s*[,;]\s*{_COLUMN}{_UNIT_BEHIND}"
    rf"(?:\s*[,;]\s*{_COLUMN})?(?:\s*[,;]\s*{_COLUMN})?\s*[\])>]"
    rf"|\b(?:format|order|columns?|as)\s*:?\s*{_COLUMN}\s*(?:,|then)\s*{_COLUMN}"
    rf"(?:\s*(?:,|then)\s*{_COLUMN})?"
)
# Columns right before the list, without a bracket: "Curvature, speed:".
PLAIN_TUPLE = re.compile(
    rf"(?:^|[\n.:]|\b(?:future|predicted|planned|next|my|the))\s*{_COLUMN}{_UNIT_BEHIND}"
    rf"\s*[,;/]\s*{_COLUMN}{_UNIT_BEHIND}\s*(?:\([^()]*\)\s*)?[:=]\W*(?:\([^()]*\))?\W*\Z"
)
# Columns in words: "(lateral offset, positive to the left; distance ahead)".
BRACKET = re.compile(r"[(\[]([^()\[\]]*)[)\]]")
COLUMN_WORDS = frozenset(
    {"lateral", "longitudinal", "sideways", "forward", "ahead", "left", "right", "along", "across"}
    | {"offset", "distance", "displacement", "position", "coordinate", "component", "deviation"}
    | {"in", "to", "the", "of", "m", "metres", "meters", "first", "second", "travelled"}
)
ALONG = frozenset({"longitudinal", "forward", "ahead"})
# Motion, not places: "(speed m/s, curvature)", "(velocity vx, vy)", "(speeds)".
_QUANTITY = (
    r"(?:speeds?|velocit(?:y|ies)|curvatures?|vx|vy|accelerations?|steering(?: angles?)?"
    r"|headings?|yaws?(?: rates?)?)"
)
_MOTION_UNIT = (
    r"(?:\s*(?:in\s+)?[\[(]?(?:k?m/[hs](?:\^?2|²)?|mph|1/m|rad(?:/[ms])?|deg(?:/s)?)[\])]?)?"
)
MOTION = re.compile(
    rf"[(\[]\s*(?:{_QUANTITY}{_MOTION_UNIT}\s*(?:,|;|/|and|&)\s*){{0,2}}(?:speeds?|velocit(?:y|ies)"
    rf"|curvatures?|vx|vy)\s*{_MOTION_UNIT}(?:\s*(?:,|;|/|and|&)\s*{_QUANTITY}{_MOTION_UNIT})*\s*[)\]]"
    r"|\bvelocit(?:y|ies)\W+vx\b|\bvx\s*,\s*vy\b|\b(?:speeds|velocities) (?:and|&) curvatures\b"
    r"|\b(?:speed|velocity)\s*(?:and|&|/|,)\s*curvature\W{0,3}[:=]\W*\Z"
)
# Places, not motion: "Waypoints: ".
PLACES = re.compile(
    r"\A(?!.*\b(?:speeds?|velocit\w+|curvatures?)\b)"
    r".*\b(way ?points?|positions?|coordinates?)\b[^\n.]{0,40}[:=]\W*\Z",
    re.DOTALL,
)
LENGTHS_M = {
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
SPEEDS_MPS = {
    "m/s": 1.0,
    "mps": 1.0,
    "km/h": 1 / 3.6,
    "kmh": 1 / 3.6,
    "kph": 1 / 3.6,
    "mph": 0.44704,
    "ft/s": 0.3048,
    "knots": 1852 / 3600,
}
CURVATURES_PM = {
    "1/m": 1.0,
    "rad/m": 1.0,
    "m^-1": 1.0,
    "m⁻¹": 1.0,
    "1/km": 0.001,
    "deg/m": math.pi / 180,
}
HUNDREDTHS = re.compile(r"(?<![\d.])100(?![\d.])|\bhundredths?\b|\bcenti")
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
    {*LENGTHS_M, *SPEEDS_MPS, *CURVATURES_PM, *_NO_UNITS, "normalized", "normalised"},
    key=len,
    reverse=True,
)
UNIT = re.compile(
    r"(?:[(\[,;]\s*|(?<!\d)/\s*|\bin\s+|\bunits?\W{1,5}(?:are|is)?\s*)("
    + "|".join(map(re.escape, _ALL))
    + r")(?![\w/^])"
)
# Points of a picture or grid, where the unit has further words: "(BEV pixels)".
PICTURE = re.compile(
    r"(?:[(\[]|\bin )(?:[^\W\d]+ ){1,2}(?P<unit>pixels?|px|voxels?|cells?)\b(?! of \d)"
)
# A unit of several: "units of 10 m", "x10 cm", "1 unit = 10 m".
MULTIPLE = re.compile(
    r"(?:\bunits? (?:of|=|is)\s*|[(\[,;]\s*[x×*]\s?)(\d*\.?\d+)\s*("
    + "|".join(sorted(map(re.escape, LENGTHS_M), key=len, reverse=True))
    + r")\b"
)
SCALED = re.compile(
    r"\b(?:scaled?|multiplied|divided|normali[sz]ed|factor)\b(?: (?:by|to|with|of|factor|a))*"
    r"\W{0,2}\d"
)
# The unit of each axis: "x in m, y in cm".
UNIT_OF_AXIS = re.compile(
    r"\b([xy])\s*(?:\bin\b|\[|\()\s*("
    + "|".join(sorted(map(re.escape, LENGTHS_M), key=len, reverse=True))
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
OTHER_FRAME = re.compile(
    r"\b(?:global|world|map|utm|enu|geographic|gps|image|camera|frenet|polar|lidar|sensor|radar)"
    r"[ -]"
    r"(?:frame|coordinates?|coordinate system|axes|space|plane)\b"
    r"|\b(?:utm|wgs[- ]?84|ecef|epsg)\b|(?<=[(\[])\s*(?:ned|enu)\b|\b(?:ned|enu)\s*(?=[)\]])"
    r"|\bin (?:local )?(?:ned|enu)\b"
)
# Ways of single steps, not places.
DIFFERENCES = re.compile(
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
POSITIVE_SIDE = re.compile(
    r"(?:positive|\+)\W*(?:(?:is|to|the|towards?|values?|means?|are|curvatures?|a|=)\W*)*(left|right)"
    r"|\b(left|right)(?:wards?)?\W*(?:(?:is|are|being|=)\W*)?(?:positive|\+)"
)
NEGATIVE_SIDE = re.compile(
    r"\bnegative\W*(?:(?:is|to|the|towards?|values?|means?|are|curvatures?|a|=)\W*)*(left|right)"
    r"|\b(left|right)(?:wards?)?\W*(?:(?:is|are|being|=)\W*)?negative"
)
# A turn to the right as the positive side of a curvature.
RIGHT_TURN = "curvature to the right"
MIRRORED = {
    "left": "right",
    "right": "left",
    "forward": "backward",
    "backward": "forward",
    "curvature": RIGHT_TURN,
    RIGHT_TURN: "curvature",
}
BACKWARDS = re.compile(
    r"\b(?:latest|last|newest|farthest|furthest|final) (?:point |one |row |time )?first\b"
    r"|\bfrom (?:the )?(?:last|latest|farthest|furthest|final) (?:\w+ )?(?:back )?to (?:the )?"
    r"(?:first|earliest|nearest|next)\b"
    r"|\brevers\w+(?: chronological)? order\b|\bbackwards? in time\b|\bin reverse\b"
    r"|\border (?:reversed?|descending|backwards?)\b"
)


def in_usual_words(text: str) -> str:
    """Replace other words by those that the patterns read; ``text`` is in lower case."""
    for words, usual in _USUAL:
        text = words.sub(usual, text)
    return _SIDE_OF_AXIS.sub(r"\1", text)
