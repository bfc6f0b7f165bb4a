"""What a whole package of one scenario holds (METHOD 4), and what this one lacks of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ssp_core.vocabulary import DOMAINS
from ssp_eval.package.index import Index
from ssp_eval.package.model import Link


def missing_parts(
    index: Index, cells: Mapping[str, Mapping[str, Any]], links: Iterable[Link]
) -> list[str]:
    """One line for each part of P_s that is not there, by scenario.

    Source video, K*, artefacts and recording of each domain, labels and log are needed; an audit
    too, without which no recording is admitted.

    Args:
        index: of the package.
        cells: facts of each cell by its path.
        links: of the package.
    """
    links = list(links)
    used = {link.hash for link in links if link.kind == "bag"}
    recordings = [r for digest, r in index.recordings.items() if digest in used]
    scenarios = {str(facts.get("scenario")) for facts in cells.values()}
    scenarios |= {r.scenario for r in recordings if r.scenario is not None}
    found: list[str] = []
    for scenario in sorted(scenarios):
        domains = {r.domain for r in recordings if r.scenario == scenario}
        found += [f"{scenario}: no {d} recording" for d in DOMAINS if d not in domains]
        own = {path for path, facts in cells.items() if facts.get("scenario") == scenario}
        if not own:
            found.append(f"{scenario}: no evaluated cell")
        unaudited = own - {link.source for link in links if link.kind == "audit"}
        found += [f"{path}: no audit" for path in sorted(unaudited)]
    there = {link.source for link in links if link.kind == "source_video"}
    found += [f"{path}: no source video" for path in sorted(set(index.sources) - there)]
    if not index.contents.of("log"):
        found.append("no log")
    return found
