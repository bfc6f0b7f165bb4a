"""The tables of an ablation: per arm, per field, per place, and paired tests between arms."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ssp_eval.ablation.campaign import ARMS, Realisation
from ssp_eval.ablation.ground import VUT_SPREAD
from ssp_eval.data.audit import FIELDS
from ssp_eval.statistics.comparisons import step_down
from ssp_eval.statistics.paired import (
    Shares,
    Test,
    hodges_lehmann,
    mcnemar,
    paired_difference,
    rate_interval,
    signed_rank,
)
from ssp_eval.statistics.resampling import NO_INTERVAL, Interval, t_interval
from ssp_eval.statistics.table import Column, Table, Value

_NOTES = (
    "A realisation is a place and a seed. Shares are of all realisations of an arm, with Wilson's "
    "interval of 95 %; KPR and EPD are means over those that were measured, with Student's. Event "
    "lost: the arm made a run, and it isn't admitted.",
    "Intervals and tests speak of these places, this source and a VUT up to "
    f"{VUT_SPREAD:.0%} slower or faster than planned, and of no other.",
    "Admitted is METHOD 4.4 as far as states show it: camera, pictures and log aren't judged.",
)


@dataclass(frozen=True)
class Measure:
    """A yes or no of each realisation.

    Args:
        of: reads it; False where there is no run.
        of_runs: it is asked of realisations that the arm made a run for, and of no other.
    """

    key: str
    title: str
    of: Callable[[Realisation], bool]
    of_runs: bool = False

    def counts(self, one: Realisation) -> bool:
        """Tell whether it is asked of a realisation."""
        return one.compiled or not self.of_runs


def _judgement_flag(key: str) -> Callable[[Realisation], bool]:
    return lambda one: one.judgement is not None and bool(getattr(one.judgement, key))


def _retention_flag(field: str) -> Callable[[Realisation], bool]:
    return lambda one: one.judgement is not None and one.judgement.retention.get(field, False)


SHARES = (
    Measure("compiled", "compiled", lambda one: one.compiled),
    Measure("valid", "valid", _judgement_flag("valid")),
    Measure("off_spec", "off_spec", _judgement_flag("off_spec")),
    Measure("admitted", "admitted", _judgement_flag("admitted")),
    Measure(
        "lost", "event lost", lambda one: one.compiled and not _judgement_flag("admitted")(one)
    ),
)
FIELD_SHARES = (
    *(
        Measure(name, name.replace("_", " "), _retention_flag(name), of_runs=True)
        for name in FIELDS
    ),
    Measure("located", "phases located", _judgement_flag("located"), of_runs=True),
)


_TITLES = {measure.key: measure.title for measure in (*SHARES, *FIELD_SHARES)}


@dataclass(frozen=True)
class Share:
    """A share of an arm's realisations; None where it is asked of none."""

    count: int
    n: int
    interval: Interval

    @property
    def value(self) -> float | None:
        return self.count / self.n if self.n else None


def share_of_arm(realisations: Sequence[Realisation], arm: str, measure: Measure) -> Share:
    """Return the share of an arm's realisations with a yes, and Wilson's interval."""
    own = [one for one in realisations if one.arm == arm and measure.counts(one)]
    count = sum(measure.of(one) for one in own)
    interval = rate_interval(count / len(own), len(own)) if own else NO_INTERVAL
    return Share(count, len(own), interval)


def values_of(realisations: Sequence[Realisation], arm: str, key: str) -> list[float]:
    """Return KPR or EPD of an arm where it was measured."""
    own = (getattr(one.judgement, key) for one in realisations if one.arm == arm and one.judgement)
    return [value for value in own if value is not None]


def arms_table(realisations: Sequence[Realisation]) -> Table:
    """Return one row per arm: compiled, valid, off_spec, KPR, EPD, admitted."""
    columns = [Column("arm", "arm", "text"), Column("n", "N", "count")]
    for measure in SHARES:
        columns += _with_ends(measure.key, measure.title)
    for key in ("kpr", "epd"):
        columns += [Column(f"{key}_n", f"{key.upper()} n", "count", printed=False)]
        columns += _with_ends(key, key.upper())
    rows = []
    for arm in ARMS:
        row: list[Value] = [arm, sum(one.arm == arm for one in realisations)]
        for measure in SHARES:
            share = share_of_arm(realisations, arm, measure)
            row += [share.value, share.interval.low, share.interval.high]
        for key in ("kpr", "epd"):
            values = values_of(realisations, arm, key)
            mean = math.fsum(values) / len(values) if values else None
            ends = t_interval(values)
            row += [len(values), mean, ends.low, ends.high]
        rows.append(tuple(row))
    title = "Realisations of one event by arm"
    return Table("arms", title, tuple(columns), tuple(rows), _NOTES)


def _with_ends(key: str, title: str) -> list[Column]:
    ends = (("", ""), ("_low", " low"), ("_high", " high"))
    return [Column(f"{key}{end}", f"{title}{words}", "decimal") for end, words in ends]


def fields_table(realisations: Sequence[Realisation]) -> Table:
    """Return one row per arm: of the runs that it made, the share that keeps each field of KPR."""
    columns = [Column("arm", "arm", "text"), Column("n", "runs", "count")]
    for measure in FIELD_SHARES:
        columns += [Column(measure.key, measure.title)]
    rows = []
    for arm in ARMS:
        row: list[Value] = [arm, sum(one.arm == arm and one.compiled for one in realisations)]
        row += [share_of_arm(realisations, arm, measure).value for measure in FIELD_SHARES]
        rows.append(tuple(row))
    title = "Fields of KPR that are kept, as shares of the runs that an arm made"
    return Table("fields", title, tuple(columns), tuple(rows), _NOTES[1:2])


@dataclass(frozen=True)
class Pair:
    """Two arms, compared by one measure on the same realisations.

    Args:
        n: realisations that both have.
        difference: first less second: of shares, or Hodges and Lehmann's shift.
        test: over realisations; None: all of a place are alike, and say nothing of each other.
        by_place: over places, each of which counts once.
    """

    first: str
    second: str
    measure: str
    n: int
    difference: float | None
    interval: Interval
    test: Test | None
    by_place: Test


def pairs_of(realisations: Sequence[Realisation]) -> list[Pair]:
    """Compare each two arms by each measure: McNemar's test of shares, signed ranks of values."""
    pairs = []
    for first, second in combinations(ARMS, 2):
        measures = (*SHARES, *FIELD_SHARES)
        pairs += [_shares(realisations, first, second, measure) for measure in measures]
        pairs += [_values(realisations, first, second, key) for key in ("kpr", "epd")]
    return pairs


Place = tuple[str, int]


def _by_place(first: dict[Place, float], second: dict[Place, float]) -> tuple[list[Place], Test]:
    both = [place for place in first if place in second]
    means = []
    for name in dict.fromkeys(place for place, _ in both):
        own = [first[key] - second[key] for key in both if key[0] == name]
        means.append(math.fsum(own) / len(own))
    return both, signed_rank(means)


def _shares(realisations: Sequence[Realisation], first: str, second: str, measure: Measure) -> Pair:
    one, other = (
        {
            (r.place, r.seed): float(measure.of(r))
            for r in realisations
            if r.arm == arm and measure.counts(r)
        }
        for arm in (first, second)
    )
    both, by_place = _by_place(one, other)
    more = sum(one[key] > other[key] for key in both)
    fewer = sum(one[key] < other[key] for key in both)
    difference = (more - fewer) / len(both) if both else None
    if measure.key == "compiled":
        return Pair(first, second, measure.key, len(both), difference, NO_INTERVAL, None, by_place)
    interval = NO_INTERVAL
    if both:
        flags = [np.array([side[key] for key in both]) for side in (one, other)]
        interval = paired_difference(Shares.of(*flags), len(both))
    test = mcnemar(more, fewer)
    return Pair(first, second, measure.key, len(both), difference, interval, test, by_place)


def _values(realisations: Sequence[Realisation], first: str, second: str, key: str) -> Pair:
    one, other = (
        {
            (r.place, r.seed): float(getattr(r.judgement, key))
            for r in realisations
            if r.arm == arm and r.judgement is not None and getattr(r.judgement, key) is not None
        }
        for arm in (first, second)
    )
    both, by_place = _by_place(one, other)
    differences = [one[key] - other[key] for key in both]
    shift, interval = hodges_lehmann(differences)
    return Pair(first, second, key, len(both), shift, interval, signed_rank(differences), by_place)


def pairs_table(realisations: Sequence[Realisation]) -> Table:
    """Return one row per two arms and measure, with paired tests."""
    columns = (
        Column("first", "first", "text"),
        Column("second", "second", "text"),
        Column("measure", "measure", "text"),
        Column("n", "n", "count"),
        Column("more", "first more", "count"),
        Column("fewer", "second more", "count"),
        Column("difference", "difference", "signed"),
        Column("low", "low", "signed"),
        Column("high", "high", "signed"),
        Column("p", "p", "p"),
        Column("p_place", "p over places", "p"),
        Column("p_least", "least p over places", "p"),
    )
    rows = [
        (
            *(one.first, one.second, one.measure, one.n),
            *((None, None) if one.test is None else (one.test.more, one.test.fewer)),
            *(one.difference, one.interval.low, one.interval.high),
            *(None if one.test is None else one.test.p, one.by_place.p, one.by_place.p_least),
        )
        for one in pairs_of(realisations)
    ]
    notes = (
        "p: McNemar's exact test of shares, Wilcoxon's signed rank of KPR and EPD, over "
        "realisations; fields, KPR and EPD where both arms made a run. p over places: signed rank, "
        "each place counted once; no outcome on so few places passes under the least p.",
        *_NOTES[1:2],
    )
    return Table("pairs", "Arms compared on the same realisations", columns, tuple(rows), notes)


def places_table(realisations: Sequence[Realisation]) -> Table:
    """Return one row per place and arm: realisations, those admitted, and the commonest reason."""
    columns = (
        Column("place", "place", "text"),
        Column("arm", "arm", "text"),
        Column("n", "N", "count"),
        Column("compiled", "compiled", "count"),
        Column("admitted", "admitted", "count"),
        Column("why", "first reason against", "text"),
    )
    rows = []
    for place in dict.fromkeys(one.place for one in realisations):
        for arm in ARMS:
            own = [one for one in realisations if (one.place, one.arm) == (place, arm)]
            admitted = [one for one in own if one.judgement is not None and one.judgement.admitted]
            why = next((one.why for one in own if one.why), "")
            compiled = sum(one.compiled for one in own)
            rows.append((place, arm, len(own), compiled, len(admitted), why))
    return Table("places", "Realisations by place", columns, tuple(rows), ())


def tables_of(realisations: Sequence[Realisation]) -> list[Table]:
    """Return the tables of an ablation without its control."""
    return [
        arms_table(realisations),
        fields_table(realisations),
        pairs_table(realisations),
        places_table(realisations),
    ]


def findings(realisations: Sequence[Realisation]) -> list[str]:
    """Say for what structure matters: where it differs from an arm without it, and on how much.

    A p is over places, each counted once, and adjusted after Holm for all that is compared.
    """
    pairs = [one for one in pairs_of(realisations) if one.first == ARMS[0]]
    adjusted = step_down([one.by_place.p for one in pairs])
    lines = []
    for other in ARMS[1:]:
        differing = [
            f"{_TITLES.get(one.measure, one.measure.upper())} {one.difference:+.2f} on "
            f"{one.by_place.more + one.by_place.fewer} place(s), p {p:.2g}"
            for one, p in zip(pairs, adjusted, strict=True)
            if one.second == other and one.difference and one.by_place.p_least < 1.0
        ]
        differences = "; ".join(differing) or "nothing differs on more than one place"
        lines.append(f"{ARMS[0]} less {other}: {differences}")
        single = [
            f"{_TITLES.get(one.measure, one.measure.upper())} {one.difference:+.2f}"
            for one in pairs
            if one.second == other and one.difference and one.by_place.p_least >= 1.0
        ]
        if single:
            lines.append(f"  on a single place: {', '.join(single)}")
    least = min((one.by_place.p_least for one in pairs), default=1.0)
    lines.append(
        f"p over places, after Holm for {len(pairs)} comparisons; before it none can be under "
        f"{least:.2g} on so few places"
    )
    return lines
