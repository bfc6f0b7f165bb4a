"""The forms of verbs: base, s, ing, ed."""

from __future__ import annotations

# Forms that the rules of inflect don't give.
IRREGULAR: dict[str, tuple[str, str, str]] = {
    "come": ("comes", "coming", "came"),
    "sit": ("sits", "sitting", "sat"),
    "catch": ("catches", "catching", "caught"),
    "lie": ("lies", "lying", "lain"),
    "freeze": ("freezes", "freezing", "frozen"),
    "break": ("breaks", "breaking", "broken"),
    "shoot": ("shoots", "shooting", "shot"),
    "fly": ("flies", "flying", "flew"),
    "hop": ("hops", "hopping", "hopped"),
    "trot": ("trots", "trotting", "trotted"),
    "pop": ("pops", "popping", "popped"),
    "zip": ("zips", "zipping", "zipped"),
    "scurry": ("scurries", "scurrying", "scurried"),
    "spring": ("springs", "springing", "sprung"),
    "slip": ("slips", "slipping", "slipped"),
    "skip": ("skips", "skipping", "skipped"),
    "hurry": ("hurries", "hurrying", "hurried"),
    "draw": ("draws", "drawing", "drew"),
    "meet": ("meets", "meeting", "met"),
    "give": ("gives", "giving", "gave"),
    "cut": ("cuts", "cutting", "cut"),
    "set": ("sets", "setting", "set"),
    "stop": ("stops", "stopping", "stopped"),
    "run": ("runs", "running", "ran"),
    "get": ("gets", "getting", "got"),
    "let": ("lets", "letting", "let"),
    "go": ("goes", "going", "went"),
    "jog": ("jogs", "jogging", "jogged"),
    "drop": ("drops", "dropping", "dropped"),
    "step": ("steps", "stepping", "stepped"),
    "hold": ("holds", "holding", "held"),
    "keep": ("keeps", "keeping", "kept"),
    "stick": ("sticks", "sticking", "stuck"),
    "put": ("puts", "putting", "put"),
    "drive": ("drives", "driving", "drove"),
    "ride": ("rides", "riding", "rode"),
    "leave": ("leaves", "leaving", "left"),
    "bring": ("brings", "bringing", "brought"),
    "stand": ("stands", "standing", "stood"),
    "bear": ("bears", "bearing", "bore"),
    "speed": ("speeds", "speeding", "sped"),
    "fall": ("falls", "falling", "fell"),
    "begin": ("begins", "beginning", "began"),
    "lose": ("loses", "losing", "lost"),
    "travel": ("travels", "traveling", "traveled"),
    "stall": ("stalls", "stalling", "stalled"),
    "yield": ("yields", "yielding", "yielded"),
    "roll": ("rolls", "rolling", "rolled"),
    "stroll": ("strolls", "strolling", "strolled"),
}


def inflect(phrase: str) -> tuple[tuple[str, str], ...]:
    """The forms of a verb phrase, as (words, form) with form base, s, ing or ed.

    Forms that stand in the phrase itself, as base|s|ing|ed, are taken as they are; one that is
    empty or left out isn't this verb's: another table says what these words are.
    """
    if "|" in phrase:
        forms = zip(phrase.split("|"), ("base", "s", "ing", "ed"), strict=False)
        return tuple((words, form) for words, form in forms if words)
    head, _, rest = phrase.partition(" ")
    third, ing, past = IRREGULAR.get(head) or _regular(head)
    tail = f" {rest}" if rest else ""
    pairs = [(head + tail, "base"), (third + tail, "s"), (ing + tail, "ing"), (past + tail, "ed")]
    return tuple(dict(reversed(pairs)).items())


def _regular(head: str) -> tuple[str, str, str]:
    third = head + ("es" if head.endswith(("s", "sh", "ch", "x")) else "s")
    stem = head[:-1] if head.endswith("e") else head
    return third, stem + "ing", stem + "ed"
