"""From the stored files of a package to everything that its table says of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ssp_eval.package.audits import Audits
from ssp_eval.package.chains import Chains
from ssp_eval.package.contents import Contents
from ssp_eval.package.index import Index, Problem
from ssp_eval.package.links import Links
from ssp_eval.package.model import Chain, Link
from ssp_eval.package.parts import missing_parts


@dataclass(frozen=True)
class Findings:
    """What the files say.

    Args:
        links: in order.
        chains: one per label of a scored cell.
        missing: parts that a whole package would hold.
        problems: links that don't hold.
        notes: what could not be checked, and why.
    """

    links: Sequence[Link]
    chains: Sequence[Chain]
    missing: Sequence[str]
    problems: Sequence[Problem]
    notes: Sequence[str]


def work_out(contents: Contents, on_step: Callable[[str], None] = lambda _: None) -> Findings:
    """Reads everything and follows every link; the same files always give the same findings.

    Args:
        contents: of the package.
        on_step: told what is done next, where it takes some seconds.
    """
    index = Index(contents, on_step)
    links = Links(index)
    links.derive()
    chains = Chains(index)
    for path, facts in sorted(links.cells.items()):
        chains.add(path, facts)
    audits = Audits(index, on_step)
    audits.check()
    found = [*links.found, *chains.links]
    return Findings(
        links=sorted(found, key=lambda link: (link.source, link.at, link.target)),
        chains=chains.found,
        missing=missing_parts(index, links.cells, found),
        problems=list(
            dict.fromkeys([*index.problems, *links.problems, *audits.problems, *chains.problems])
        ),
        notes=[*index.notes, *audits.notes, *chains.notes],
    )
