"""Stage 3c: phrases about the pedals: off the gas, lift the foot, apply the brakes gently."""

from __future__ import annotations

from ssp_eval.extract.rules.free_phrases.found import Found
from ssp_eval.extract.rules.free_phrases.speed_nouns import FILLERS
from ssp_eval.extract.rules.words.notation import phrases

HEADS = frozenset(
    phrases(
        """
        take, takes, taking, lift, lifts, lifting, ease, eases, easing, let, lets, letting, come,
        coming, get, getting, release, releases, releasing, off, apply, applies, applying, press,
        presses, pressing, hit, tap, taps, tapping, squeeze, squeezing, slam, touch, use, using
        """
    )
)


def pedal(words: list[str], at: int, form: str) -> Found | None:
    """off the gas, lift the foot, take the foot off the accelerator, apply the brakes gently."""
    off = words[at] in ("off", "release", "releases", "releasing", "lift", "lifts", "lifting")
    braking = words[at].startswith(("appl", "press", "hit", "tap", "squeez", "slam", "us", "touch"))
    if words[at + 1 : at + 2] == ["of"]:
        return None  # the release of the accelerator
    for here in range(at + 1, min(at + 8, len(words))):
        word = words[here]
        if word in ("off", "from"):
            off = True
        elif word in ("gas", "accelerator", "throttle"):
            if braking and not off:
                return "accelerate", form, at, here + 1  # press the accelerator gently
            return ("slow", form, at, here + 1) if off else None
        elif word in ("brake", "brakes", "braking"):
            return ("brake", form, at, here + 1) if braking else None
        elif word in ("foot", "right"):
            if words[at].startswith("lift") and word == "foot":
                off = True
        elif word not in FILLERS and word not in (
            "firm",
            "hard",
            "on",
            "light",
            "strong",
            "gentle",
        ):
            break
    if words[at].startswith("lift") and "foot" in words[at + 1 : at + 4]:
        return "slow", form, at, words.index("foot", at) + 1
    return None
