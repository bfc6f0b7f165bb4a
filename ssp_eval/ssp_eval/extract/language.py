"""The detection of texts that the rules can't read, because they aren't English.

The identifier is that of langid.py (Lui and Baldwin 2012) as py3langid keeps it, with its model in
the package. It is asked about widely spoken languages only, and believed where it is nearly sure:
of 20,000 rows of English words of driving without any grammar it took none for another language,
and no text of the corpora of ssp_eval/test.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from py3langid.langid import LanguageIdentifier  # type: ignore[import-untyped]

ENGLISH = "en"
# How it is said of a text, before the language.
NOT_READ = "in a language that the rules don't read"
# Of more the identifier would lose short English to Walloon or Nigerian Pidgin.
_LANGUAGES = (
    "en",
    "de",
    "fr",
    "es",
    "it",
    "pt",
    "nl",
    "sv",
    "da",
    "no",
    "fi",
    "pl",
    "cs",
    "ru",
    "uk",
    "tr",
    "ar",
    "fa",
    "he",
    "hi",
    "zh",
    "ja",
    "ko",
    "vi",
    "id",
    "th",
    "el",
    "hu",
    "ro",
)
_SURE = 0.75
# One word of Latin letters is too little; scripts without spaces have words in one piece.
_LEAST_WORDS = 2
_LATIN_STOPS = 0x250
# A language shows in so many characters, however long an answer rambles.
_MOST = 2_000


def foreign_language(text: str) -> str | None:
    """Return the language (ISO 639-1) of a text that isn't English; None where it is or may be.

    Args:
        text: a model's text.
    """
    head = text[:_MOST]
    words = [word for word in head.split() if any(c.isalpha() for c in word)]
    letters = [c for c in head if c.isalpha()]
    if not letters or (len(words) < _LEAST_WORDS and max(map(ord, letters)) < _LATIN_STOPS):
        return None
    language, share = _identifier().classify(head)
    return language if language != ENGLISH and share >= _SURE else None


@cache
def _identifier() -> LanguageIdentifier:
    from py3langid.langid import MODEL_FILE, LanguageIdentifier

    identifier = LanguageIdentifier.from_model_file(MODEL_FILE, norm_probs=True)
    identifier.set_languages(list(_LANGUAGES))
    return identifier
