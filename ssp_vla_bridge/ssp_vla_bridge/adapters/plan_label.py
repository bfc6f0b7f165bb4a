"""The owner of a list in a text, by the words before it (METHOD 5.4b, *Own plan*)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

_LOOKED_AT = 400
_FENCE = re.compile(r"^\s*(?:```|~~~)")
# Lines that name units, axes, times or an order, and nothing else.
_FORMAT = """
x y z t v k c m s dx dy δx δy
in the and to with of at is are unit units axis axes metre metres meter meters
feet foot ft cm mm km px pixels seconds second sec steps step every apart forward forwards ahead
left right lateral longitudinal positive negative speed curvature time times origin frame format
columns column order json each per point row km/h m/s mph hz
"""
_FORMAT_WORDS = frozenset(_FORMAT.split())
_WORD = re.compile(r"[^\W\d_]+(?:/[^\W\d_]+)?")
_KEY = re.compile(r"[\"']([\w .\-]{1,60})[\"']\s*:\s*\Z")
# A key of one object that holds another object or list, seen from its opening bracket.
_PARENT = re.compile(r"[\"']([\w .\-]{1,60})[\"']\s*:\s*[\[{]*\s*\Z")
# An element of XML that opens or closes; one that closes itself holds nothing.
_ELEMENT = re.compile(
    r"<(?P<close>/?)(?P<name>[A-Za-z][\w.\-]{0,40})(?P<more>(?:\s[^<>]{0,80})?)(?<!/)>"
)
_MOST_DEEP = 8  # elements that hold a list
_SENTENCE_END = re.compile(r"[.!?](?=\s)|\n")

PLAN_WORDS = r"(?:traj(?:s|ector(?:y|ies))?|way[ -]?points?|paths?|plans?|routes?|final answer)"
_PLAN = re.compile(rf"\b{PLAN_WORDS}\b|\b(?:future|next|planned|target) (?:points|positions)\b")
_OWN = re.compile(
    r"\b(?:my|own|ego|i|i'll|we|our|vut|myself)\b|\bego[_-]"
    r"|\b(?:autonomous|self-?driving|automated|driverless|host|subject)[ _-]"
    r"(?:car|vehicle|driving)\b"
)
# Whose list it is that the prompt asks for without a label.
_PLAIN_USER = re.compile(r"\b(?:the|this) (?:car|vehicle)\b(?:'s)?")
_FAULTY = (
    r"(?:bad|poor|infeasible|colliding|dangerous|risky|worse|worst|worst[- ]case|outdated|old"
    r"|counterfactual|superseded|obsolete|withdrawn|cancell?ed|scrapped|vetoed|disregarded|flawed"
    r"|failed|faulty|unacceptable|undesired|undesirable|inadmissible|impossible)"
)
_TOO = (
    r"too (?:\w+ly )?(?:fast|slow|close|near|aggressive|tight|sharp|abrupt|wide|late|early|far|long"
    r"|short|conservative|cautious|hard|bold|harsh|uncomfortable)"
)
# A plan that was looked at, unless the label then says which one was taken.
_LOOKED_UPON = r"(?:considered|thought (?:of|about)|looked at|evaluated|tried|tested|weighed)"
_THEN_TAKEN = (
    r"(?!.*\b(?:ch[oo]se|chosen|choose|decide|final|best|select|pick|settle|go with|take))"
)
_BETWEEN = r"(?:(?:that|which|i|we|was|were|had|have|been|first|initially|also|just|originally) )"
_REFUSED = re.compile(
    rf"\b{_FAULTY}[ _]+{PLAN_WORDS}|"
    rf"\b{PLAN_WORDS} (?:is|was|looks|looked|seems|seemed|has been|had been) (?:\w+ )?"
    rf"(?:{_FAULTY}|{_TOO})\b(?!.*\b{PLAN_WORDS}\b)|"
    rf"\b(?:i|we) (?:\w+ )?{_LOOKED_UPON} (?:[\w,]+ ){{0,3}}{PLAN_WORDS}\b(?!.*\b{PLAN_WORDS}\b)"
    rf"{_THEN_TAKEN}|"
    rf"\b{PLAN_WORDS} {_BETWEEN}{{1,5}}{_LOOKED_UPON}\b{_THEN_TAKEN}|"
    r"\b(?:i|we) (?:do not|don't|will not|won't|would not|must not|cannot|can't|should not"
    r"|shouldn't) (?:\w+ )?(?:do|follow|take|drive|choose|use|execute)(?: this| that)?\W*$|"
    rf"\b{PLAN_WORDS} (?:(?:that|which|would|will) ){{0,2}}(?:collides?|crash(?:es)?|(?:leads?"
    r"|leading|ends?|ending) (?:to|into|in) an? (?:\w+ )?(?:crash|collision|accident))\b|"
    rf"\b{PLAN_WORDS} (?:that |which )?(?:i|we) "
    r"(?:do not|don't|will not|won't|would not|must not)\b|"
    rf"\b(?:do not|don't) (?:follow|take|use|drive|execute|choose) (?:\w+ ){{1,2}}{PLAN_WORDS}|"
    r"\bto (?:avoid|be avoided)\W*$|\bnot (?:selected|chosen|to be|recommended|wanted|taken)\b|"
    r"\b(?:wrong|reject(?:ed|s)?|discard(?:ed)?|incorrect|alternatives?|examples?|e\.g|for instance"
    r"|hypothetical(?:ly)?|fallback|back-?up|contingency|counter-?example|dismiss(?:ed)?|unwanted"
    r"|invalid|not (?:the|my|a|what)|not this(?! (?:fast|slow|time))"
    r"|never|instead of|rather than|ruled out|abandoned|unsafe|forbidden)\b"
    rf"|\bbaseline[ _-]{PLAN_WORDS}\b"
    rf"|\b{PLAN_WORDS} (?:\w+ )?considered\b{_THEN_TAKEN}|\bconsidered[ _]{PLAN_WORDS}"
    r"|\bcandidate[ _](?:trajectories|paths|plans|routes)\b"
)
# A label that names another driver's or an earlier drive, and no more.
_NOT_AN_ANSWER = re.compile(
    r"\W*(?:the |my |our )?(?:(?:ground[-_ ]?truth|gt|(?:human|expert)(?: driver(?:'s)?)?|logged"
    rf"|recorded)(?: (?:future|{PLAN_WORDS}|driver|driving|positions?))*"
    r"|(?:previous|prior|earlier) (?:answer|output|response|plan|prediction))"
    r"\W*(?:\([^()]*\)\W*)?"
)
_CONDITION = re.compile(
    r"\b(?:if|unless|in case|would|were|otherwise|suppose|supposing)\b"
    r"|^\W*had (?:the|a|an|i|we|it|he|she|they|this|that)\b"
)
_BOXES = re.compile(
    r"\bb(?:ounding[ _-]?)?box(?:es)?\b|\bbbox|\bbox_(?:start|end)\b|\bdetect(?:ed|ions?|s)\b"
    r"|\b(?:key)?points? of\b|\bcorners?\b"
)
# What sensors and grids give, where it isn't called a plan.
_SENSED = re.compile(
    r"\b(?:occup(?:ancy|ied)|lidar|radar|sonar|grid|heat[ _-]?map|point[ _-]cloud|costmap|flow)"
    r"[ _-](?:grid )?(?:cells?|points?|returns?|peaks?|vectors?|grid)\b"
)
_SPECIFIC = (
    r"(?:cars?|vans?|trucks?|lorr(?:y|ies)|bus(?:es)?|coach(?:es)?|motorcycl\w+|motorbikes?|bikes?"
    r"|bicycles?|cyclists?|riders?|pedestrians?|persons?|people|man|men|woman|women|child(?:ren)?"
    r"|kids?|taxis?|trams?|scooters?|trailers?|ambulances?|animals?|dogs?|sedans?|suvs?|pickups?"
    r"|tractors?|vrus?|walkers?|runners?|joggers?|peds?|bicyclists?|motorists?|mini(?:vans?|bus(?:es)?)"
    r"|wheelchairs?|workers?|jeeps?|cabs?|hatchbacks?|limousines?)"
)
_GENERIC = (
    r"(?:agents?|actors?|obj(?:ect)?s?|obstacles?|road[ _]users?|participants?|neighbou?rs?"
    r"|leaders?|opponents?|others?|traffic|lead|followers?|tailgaters?|overtakers?"
    rf"|targets?(?! (?:{PLAN_WORDS}|points?|positions?)\b))"
)
_VEHICLE = r"vehicles?"
_QUALIFIED = (
    r"(?:other|another|lead(?:ing)?|front|preceding|parked|oncoming|adjacent|surrounding|nearby"
    r"|target|stopped|merging|crossing|each|every|second|third|opposing|following|rear)"
)
_NUMBERED = rf"(?:(?:{_VEHICLE}|obj|track|id)[ _#-]?\d+)"
_USER = rf"(?:{_SPECIFIC}|{_QUALIFIED}[ _]{_VEHICLE}|{_GENERIC}|{_NUMBERED}|{_VEHICLE})"
_ARTICLE = r"(?:the|a|an|this|that|these|those|all|any|each|every|two|three|both|some|no)?\s*"
_ADJECTIVES = r"(?:(?!(?:and|or|to|of|for|by)\b)[\w-]+\s+){0,2}?"
_NUMBER = r"(?:[ _#-]?\d+)?"
_ANY_USER = re.compile(rf"\b(?:{_SPECIFIC}|{_QUALIFIED}[ _]{_VEHICLE}|{_NUMBERED})\b")
_OWN_VEHICLE = re.compile(rf"(?:{_OWN.pattern})[ _-](?:{_SPECIFIC}|{_VEHICLE})\b")
# Somebody of whom the text spoke before: "Its predicted path".
_PRONOUN = re.compile(rf"\b(?:its|their|his|her)\b (?:\w+ ){{0,2}}(?:{PLAN_WORDS}|positions?)\b")
# A condition of what somebody does: "assuming the van brakes", but not "assuming constant speed".
_ASSUMED = re.compile(
    r"\b(?:assuming|assume|assumed|presuming|provided|as long as|so long as|in the event"
    r"|on condition|contingent on|depending on)(?: that| of| on)?"
    rf" (?:{_ARTICLE}{_ADJECTIVES}{_USER}\b"
    r"|(?:it|he|she|they|nobody|no one|someone|somebody)\b)"
)
# The road, unless a plan along it is named first: "Lane centre line: …".
_ROAD = re.compile(
    r"\b(?:cent(?:er|re)[ _-]?lines?|(?:lane|road)[ _-](?:boundar\w+|edges?|lines?|markings?)"
    r"|polylines?|polygons?|outlines?|contours?)\b"
    r"|^\W*(?:the )?(?:left|right|inner|outer)[ _-](?:lane |road )?(?:boundar\w+|edges?|borders?)\b"
)
# What a plan refers to, which may be the road's course: it labels no own plan.
_REFERENCE = re.compile(rf"\b(?:reference|ref)[ _-]{PLAN_WORDS}\b")
# A remark beside a label, which is a clause of its own: "Trajectory (the van is 3 s ahead)".
_ASIDE = re.compile(
    r"\([^()]*\b(?:is|are|was|has|have|will|since|because|as|so that|while|when)\b[^()]*\)"
)
# "My trajectory (not the van's)".
_NOT_THEIRS = re.compile(rf"\(\s*not {_ARTICLE}(?:that of |for |of )?{_ARTICLE}{_USER}\b[^()]*\)")
# A field of an item in YAML that names its owner: "- type: car", "name: ego".
_NAME_LINE = re.compile(
    r"[ \t]*(?:- )?(?:agent|actor|type|class|category|name|track|entity|participant|id)"
    r":[ \t]*[\"']?(?P<name>[^\"'\n]{1,40}?)[\"']?[ \t]*\Z"
)
# A line that is a key, of an object in YAML or as a heading: "van:", "## Vehicle 2".
_KEY_LINE = re.compile(r"(?P<indent>[ \t]*)(?:- )?[\"']?(?P<key>[\w][\w .\-]{0,40})[\"']?:[ \t]*\Z")
_HEADING = re.compile(
    r"[ \t]*(?:#{1,6}[ \t]+(?P<title>[^\n]+?)|\*\*(?P<bold>[^*\n]+)\*\*:?)[ \t:#]*\Z"
)
_NAMES_USER = re.compile(rf"{_ARTICLE}{_ADJECTIVES}{_USER}{_NUMBER}", re.IGNORECASE)
# Keys that say whose the list beside them is, where none says what is done.
_NAMED_AS = re.compile(
    r"[\"'](?:agent|actor|type|class|category|name|track|entity|participant|id)[\"']\s*:\s*"
    r"[\"']([^\"'\n]{1,40})[\"']",
    re.IGNORECASE,
)
_ACTION_KEY = re.compile(
    r"[\"'][\w ]{0,24}(?:action|decision|man(?:o?eu|eu)ver|manoeuvre|command|behaviou?r)\w{0,3}"
    r"[\"']\s*:",
    re.IGNORECASE,
)
# A line that says how all coordinates are meant.
_CONVENTION = re.compile(
    r"^\W*(?:(?:all|the|ego|my) )?(?:(?:coordinate )?(?:system|frame)(?! rate)|coordinates?|axes"
    r"|units?|convention|time ?steps?|step size|sampling"
    r"|(?:(?:planning|prediction|time) )?horizon)\b[^\n]*$",
    re.IGNORECASE | re.MULTILINE,
)
# What follows, avoids or yields is not the one whose motion is told.
_OF_OTHERS = re.compile(
    r"\b(?:yield\w*(?: to)?|giv\w+ way to|follow\w*|avoid\w*|behind|around|past|pass\w*|overtak\w*"
    r"|let\w*|after|before|near|because of|due to|considering|given|without|between|towards?"
    r"|stop\w* for|stop\w*|brak\w+ for|wait\w* for|until|while|as|since|when|so that|against"
    r"|despite"
    r"|from|with|clear(?:s|ing)? of|because|reaction to|respons\w+ to|respect to|slow\w* for)\s+"
    rf"{_ARTICLE}{_ADJECTIVES}{_USER}{_NUMBER}\b(?:'s?|s')?"
)
_OWNER = tuple(
    re.compile(pattern)
    for pattern in (
        # possessor: "the van's path", "trajectory of the bus", "positions of pedestrians"
        rf"\b{_USER}{_NUMBER}(?:'s|s'|’s|s’)",
        rf"\b(?:{PLAN_WORDS}|positions?|locations?|coordinates?|points?|motion|prediction|forecast"
        rf"|places?|centres?|centers?|velocit\w+|speeds?)\s+(?:of|for)\s+{_ARTICLE}{_ADJECTIVES}{_USER}\b",
        # attribute: "pedestrian positions", "car 2 waypoints", "agent predicted trajectory"
        rf"\b(?:{_SPECIFIC}|{_GENERIC}|{_QUALIFIED}[ _]{_VEHICLE}|{_NUMBERED}){_NUMBER}[ _]+"
        rf"(?:\w+[ _]+){{0,2}}(?:{PLAN_WORDS}|positions?|locations?|coordinates?|points?)\b",
        # "waypoints (lead car)"
        rf"\b{PLAN_WORDS} \({_ARTICLE}{_ADJECTIVES}{_USER}{_NUMBER}"
        r"(?: (?:in front|ahead|behind|beside|on the (?:left|right))(?: of (?:us|me))?)?\)",
        # subject: "cars stand at", "the van will be at", "there are road users at"
        rf"^\W*{_ARTICLE}{_ADJECTIVES}{_USER}{_NUMBER}\b",
        rf"\bthere (?:is|are|'s)\b.*\b{_USER}\b",
        rf"\b{_USER}{_NUMBER}\s+(?:\w+\s+){{0,2}}(?:at|near|around|drives?|moves?|stands?|walks?|goes"
        r"|follows?|will|is|are|takes?|predicted|crosses)\b",
        r"\b(?:other|others|another)(?:'s)? (?:\w+ ){0,2}(?:trajectory|path|plan|positions?)\b",
    )
)


class Owner(StrEnum):
    """The owner of a list."""

    OWN = "own"
    UNSAID = "unsaid"
    OTHER = "other"


@dataclass(frozen=True)
class Label:
    """The words by which a text introduces a list.

    Args:
        text: the label, in lower case.
        heading: all from the label to the list, with what stands in brackets behind the list:
            where units, axes and times are stated.
        owner: whose the list is.
    """

    text: str
    heading: str
    owner: Owner


def label_of(text: str, end_before: int, start: int, end: int, bare: bool = False) -> Label:
    """Read the label of a list.

    Args:
        text: the answer's.
        end_before: offset behind the list before.
        start: offset of the list.
        end: offset behind its last row.
        bare: the prompt asks for a list without a label, so that "the vehicle" is the own one.
    """
    begin = max(end_before, start - _LOOKED_AT)
    before = text[begin:start]
    behind = _behind(text, end)
    key = _KEY.search(before.rstrip())
    if key is not None:
        holders = _parents(text, max(0, start - 4 * _LOOKED_AT), start)
        words = " ".join([*holders, _user_beside(text, start, end), key[1]])
        label = words.replace("_", " ").lower()
        heading = f"{before}{_heading_of_key(key[1])}{behind}"
        return Label(label, heading, _owner(label, is_key=True))
    elements, is_right_before = _elements(text, start, end)
    element_owner = _owner(elements, is_key=True) if elements else Owner.UNSAID
    if element_owner is Owner.OTHER or (is_right_before and element_owner is Owner.OWN):
        return Label(elements, before + behind, element_owner)
    lines = before.split("\n")
    if begin > 0 and begin > end_before:
        lines[0] = lines[0].partition(" ")[2]
    whole = int(begin > 0)  # the first line that isn't the rest of one: a remark is no heading
    for i in range(len(lines) - 1, -1, -1):
        line = lines[i]
        if not _says_more(line):
            continue
        sentence = _SENTENCE_END.split(line.rstrip())[-1].lower()
        if not sentence.strip(" .:*`"):
            sentence = line.lower()
        own = line[max(0, line.lower().rfind(sentence)) :]
        earlier = "\n".join([*lines[:i], *_SENTENCE_END.split(line[: len(line) - len(own)])])
        heading_text = "\n".join([*_CONVENTION.findall(earlier), own, *lines[i + 1 :]])
        owner = _owner(_PLAIN_USER.sub(" ", sentence) if bare else sentence)
        parents = _parents_by_line(lines[whole:i], line)
        if owner is not Owner.OTHER and parents and _OWN.search(f"{parents} {sentence}") is None:
            owner = _owner(f"{parents} {sentence}", is_key=True)
        if _PRONOUN.search(sentence) and owner is not Owner.OTHER:
            earlier = "\n".join(lines[: i + 1]).lower().removesuffix(sentence)
            owner = Owner.OTHER if _speaks_of_user(earlier) else Owner.UNSAID
        return Label(sentence, heading_text + behind, owner)
    return Label("", before + behind, Owner.UNSAID)


def _heading_of_key(key: str) -> str:
    """Return what a list's key states, as a heading would: "trajectory_next_4_s"."""
    words = key.replace("_", " ").replace("-", " ")
    rest = _PLAN.split(words.lower())[-1].split()
    if len(rest) in (0, len(words.split())):  # it doesn't name the plan, or no more than it
        return f" ({words.rpartition(' ')[2]}) ({words})"
    columns = "y, x" if rest == ["yx"] else ", ".join(rest)
    return f" ({words}) ({' '.join(rest)}) ({columns})"


def _behind(text: str, end: int) -> str:
    """Return the text in round brackets right behind a list."""
    match = re.compile(r"[\])}\s]{0,4}?[\])}]?[ \t]*(\([^()\n]{1,60}\))").match(text, end)
    return f" {match[1]}" if match and not re.search(r"\d\s*,", match[1]) else ""


def _user_beside(text: str, start: int, end: int) -> str:
    """Return the road user whom a key beside a list's own names as its owner, or ""."""
    begin = max(text.rfind("{", max(0, start - _LOOKED_AT), start), 0)
    stop = text.find("}", end, end + _LOOKED_AT)
    beside = f"{text[begin:start]} {text[end : len(text) if stop < 0 else stop]}"
    names = [match[1].lower() for match in _NAMED_AS.finditer(beside)]
    if _ACTION_KEY.search(beside) or any(_OWN.search(name) for name in names):
        return ""
    return next((name for name in names if _NAMES_USER.fullmatch(name)), "")


def _speaks_of_user(text: str) -> bool:
    """Tell whether the last one that a text speaks of is a road user, not the own vehicle."""
    text = _OWN_VEHICLE.sub("ego", text)
    users = [match.end() for match in _ANY_USER.finditer(text)]
    own = [match.end() for match in _OWN.finditer(text)]
    return bool(users) and users[-1] > max(own, default=-1)


def _says_more(line: str) -> bool:
    if _FENCE.match(line):
        return False
    words = _WORD.findall(re.sub(r"<\|?/?(?!box)\w*\|?>", "", line.lower()))
    return any(word not in _FORMAT_WORDS for word in words)


def _elements(text: str, start: int, end: int) -> tuple[str, bool]:
    """Name the elements of XML that hold a list, and tell whether one opens right before it."""
    opened: list[re.Match[str]] = []
    for match in _ELEMENT.finditer(text, max(0, start - 2 * _LOOKED_AT), start):
        if not match["close"]:
            opened.append(match)
        elif any(one["name"] == match["name"] for one in opened):
            while opened.pop()["name"] != match["name"]:
                pass
    if not opened:
        return "", False
    behind = text[end : end + 2 * _LOOKED_AT]
    holding = [one for one in opened[-_MOST_DEEP:] if f"</{one['name']}>" in behind]
    is_right_before = bool(holding) and not text[holding[-1].end() : start].strip()
    names = [re.sub(r"[_=\"']", " ", one["name"] + one["more"]).lower() for one in holding]
    # The bare vehicle is the own one.
    names = [re.sub(rf"^vehicle(?= *$| +(?:future |planned )?{PLAN_WORDS})", "", n) for n in names]
    return " ".join(names).strip(), is_right_before


def _parents(text: str, begin: int, start: int) -> list[str]:
    """Return keys of the objects that hold a list, outermost first."""
    keys: list[str] = []
    depth = 0
    for i in range(start - 1, begin - 1, -1):
        mark = text[i]
        if mark in "]}":
            depth += 1
        elif mark in "[{":
            if depth:
                depth -= 1
            elif (match := _PARENT.search(text[max(begin, i - 80) : i])) is not None:
                keys.append(match[1])
    return keys[::-1]


def _parents_by_line(before: Sequence[str], line: str) -> str:
    """Name what holds a line in YAML, outermost first, or the road user whose heading it has."""
    key = re.match(r"([ \t]*)(- )?[\"']?[\w .\-]{1,40}[\"']?:", line)
    indent = len(key[1]) if key is not None else 0
    in_item = key is not None and key[2] is None
    parents: list[str] = []
    for one in reversed(before):
        if not one.strip():
            continue
        if not parents and (heading := _HEADING.match(one)) is not None:
            title = (heading["title"] or heading["bold"]).strip(" :*")
            return title.lower() if _NAMES_USER.fullmatch(title) else ""
        parent = _KEY_LINE.match(one)
        depth = len(one) - len(one.lstrip())
        is_item = one.lstrip().startswith("- ")
        if in_item and indent and (depth == indent or (is_item and depth < indent)):
            name_match = _NAME_LINE.match(one)
            if name_match is not None and depth + 2 * is_item == indent:
                name = name_match["name"].lower()
                parents += [name] if _NAMES_USER.fullmatch(name) or _OWN.search(name) else []
        if is_item and depth < indent:
            in_item, indent = False, depth + 1
            continue
        if depth >= indent:
            if not indent:
                break
            continue
        if parent is None:
            break
        parents.append(parent["key"].replace("_", " ").lower())
        indent = depth
    return " ".join(reversed(parents))


def _owner(words: str, is_key: bool = False) -> Owner:
    """Find the owner of a list by its label or the sentence before it, in lower case."""
    text = words.replace("’", "'").replace("*", " ").replace("`", " ").strip()
    text = _NOT_THEIRS.sub(" ", _ASIDE.sub(" ", text))
    own = _OWN.search(text) is not None
    if _NOT_AN_ANSWER.fullmatch(text):
        return Owner.OTHER
    if any(one.search(text) for one in (_REFUSED, _CONDITION, _ASSUMED, _BOXES)):
        return Owner.OTHER
    if _SENSED.search(text) and not _PLAN.search(text):
        return Owner.OTHER
    road = _ROAD.search(text)
    if road is not None and _PLAN.search(text, 0, road.start()) is None:
        return Owner.OTHER
    if not own:
        rest = _OF_OTHERS.sub(" ", text)
        if any(pattern.search(rest) for pattern in _OWNER) and not _is_plain_own(rest):
            return Owner.OTHER
        if is_key and re.search(rf"\b{_USER}\b", rest) and not _is_plain_own(rest):
            return Owner.OTHER
        if is_key and re.search(r"\bpositions?\b|\blocations?\b", rest) and not _PLAN.search(rest):
            return Owner.OTHER
    plan_text = text if own else _REFERENCE.sub(" ", text)
    plan = _PLAN.search(plan_text) is not None or (
        own and re.search(r"\bpositions?|points?\b", text)
    )
    return Owner.OWN if plan else Owner.UNSAID


def _is_plain_own(words: str) -> bool:
    """Tell a label of the bare vehicle, which is the own one: "Vehicle trajectory"."""
    return (
        re.fullmatch(rf"\W*(?:the )?vehicle(?:'s)?[ _]*(?:future |planned )?{PLAN_WORDS}\W*", words)
        is not None
    )
