"""Names of the vocabularies as people write them."""

import click
import pytest

from ssp_core.options import Domain
from ssp_core.vocabulary import DOMAINS, read_domain


@pytest.mark.parametrize(
    ("text", "word"),
    [
        *((word, word) for word in DOMAINS),
        ("Syn", "synthetic"),
        ("SIM", "simulation"),
        ("phy", "physical"),
        ("Physical", "physical"),
        ("track", None),
        ("", None),
        ("s", None),
        ("simul", None),
    ],
)
def test_a_domain_is_read_by_its_word_or_its_short_name(text: str, word: str | None) -> None:
    assert read_domain(text) == word
    if word is not None:
        assert Domain().convert(text, None, None) == word
        return
    with pytest.raises(click.BadParameter, match=r"is no domain; known: synthetic, .* Phy"):
        Domain().convert(text, None, None)
