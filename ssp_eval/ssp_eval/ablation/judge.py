"""The judgement of a realisation, by its measured states, the same for all arms (METHOD 4).

It takes the true states of a session, the road under them and K*. What an arm knew, chose or
checked doesn't enter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ssp_core.motion.state_series import Series, between
from ssp_core.run_file.road import Road
from ssp_core.vocabulary import Verdict
from ssp_eval.ablation.ground import Trial
from ssp_eval.audit.checks import further_findings, phase_findings, property_findings
from ssp_eval.audit.evidence.evidence import expected_properties, outside_ranges, varying_parts
from ssp_eval.audit.evidence.holding import holding_initiator
from ssp_eval.audit.evidence.leaving import leaving_occluder
from ssp_eval.audit.evidence.measure import Measurements, RoadFacts, Scene, measure
from ssp_eval.data.audit import (
    EVENT_PHASES,
    FIELDS,
    TOPOLOGY,
    is_equal,
    phase_difference,
    phase_fraction,
    property_retention,
)
from ssp_eval.recordings.event import EventRules, crop_of, phase_starts, rules_of, source_times
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.run.result import rounded
from ssp_scenario_manager.scenarios.further import further_ids


@dataclass(frozen=True)
class Judgement:
    """The findings on a realisation.

    Args:
        verdict: of its session.
        off_spec: sound, but without K*'s passing order, time gap, or event.
        retention: q(d, k) = q(Syn, k) per field of KPR; empty: nothing could be measured.
        kpr: METHOD 4; None without measured states.
        epd: METHOD 4; None where a phase isn't located.
        located: every key phase is located.
        time_gap_s: at the conflict point; None: there is none.
        admitted: METHOD 4.4 as far as states show it.
        why: primary reason against it; empty: it is admitted.
    """

    verdict: str
    off_spec: bool = False
    retention: Mapping[str, bool] = field(default_factory=dict)
    kpr: float | None = None
    epd: float | None = None
    located: bool = False
    time_gap_s: float | None = None
    admitted: bool = False
    why: str = ""

    @property
    def valid(self) -> bool:
        """Sound, and the event took place with K*'s order and gap."""
        return self.verdict == "valid" and not self.off_spec


def judge_trial(event: Event, road: Road, words: Mapping[str, str], trial: Trial) -> Judgement:
    """Judge one executed realisation.

    Args:
        event: K*.
        road: under the states.
        words: road type and boundaries of the place, as far as it says.
        trial: the session.
    """
    result = trial.result
    verdict = result.verdict.name.lower()
    first = "; ".join(result.reasons)
    sound = result.verdict in (Verdict.VALID, Verdict.OFF_SPEC)
    measured = _measured(event, road, words, trial.series)
    if measured is None:
        return Judgement(verdict, off_spec=verdict == "off_spec", why=first or "no states")
    expected, varying = expected_properties(event), varying_parts(event)
    targets = {k: q.without(varying) if k == TOPOLOGY else q for k, q in expected.items()}
    properties = {
        k: q.without(varying) if k == TOPOLOGY else q for k, q in measured.properties.items()
    }
    retention = {k: k in properties and is_equal(properties[k], targets[k]) for k in FIELDS}
    weights = {str(k): w for k, w in event.constraints.weights.items()}
    gap_s = measured.facts["time_gap_s"]
    passing = _passing(event, gap_s, order_kept=retention["passing_order"])
    findings = property_findings(properties, targets, measured.phases, measured.first_arrival_s)
    missing = phase_findings(measured.phases, "")
    outside = outside_ranges(event, measured.properties[TOPOLOGY])
    further = further_findings(event, measured, rules_of(event).thresholds)
    off_spec = verdict == "off_spec" or (sound and bool(passing))
    reasons = [
        *([first] if not sound else []),
        *(finding.detail for finding in (*findings, *missing, *further)),
        *outside,
        *passing,
        *([first] if first and sound else []),
    ]
    return Judgement(
        verdict=verdict,
        off_spec=off_spec,
        retention=retention,
        kpr=property_retention(properties, targets, weights),
        epd=_epd(event, measured),
        located=not missing,
        time_gap_s=rounded(gap_s),
        admitted=not reasons,
        why=reasons[0] if reasons else "",
    )


def _passing(event: Event, gap_s: float | None, *, order_kept: bool) -> list[str]:
    """List how passing order and time gap depart from K*, where they are determined."""
    departures = []
    if not order_kept:
        departures.append(f"passing order isn't {' before '.join(event.interaction.passing_order)}")
    target = event.constraints.time_gap
    if gap_s is not None and isinstance(target, Interval) and not target.si.holds(gap_s):
        span = target.si
        departures.append(f"time gap {gap_s:.2f} s, K* has {span.low:g} to {span.high:g} s")
    return departures


def _measured(
    event: Event, road: Road, words: Mapping[str, str], series: Series
) -> Measurements | None:
    """Measure the states within the clip that METHOD 4.1 makes of them."""
    if len(series) < 2:
        return None
    rules, facts = rules_of(event), RoadFacts(road, words)
    first_s, last_s = series[0][0], series[-1][0]
    try:
        whole = measure(_scene(event, series, facts, rules, first_s, last_s))
        crop = crop_of(
            first_s, last_s, whole.phases.trigger_s, whole.phases.resolution_s, rules.window
        )
        part = between(series, crop.start_s, crop.end_s)
        return measure(_scene(event, part, facts, rules, crop.start_s, crop.end_s))
    except ValueError:
        return None


def _scene(
    event: Event,
    series: Series,
    road: RoadFacts,
    rules: EventRules,
    start_s: float,
    end_s: float,
) -> Scene:
    targets = tuple(name for name in event.participants if name != event.vut_id)
    return Scene(
        series,
        event.vut_id,
        targets,
        road,
        start_s,
        end_s,
        rules,
        further_ids(event),
        leaving_id=leaving_occluder(event),
        holding_id=holding_initiator(event),
    )


def _epd(event: Event, measured: Measurements) -> float | None:
    """Compare φ of the phases with the source's (METHOD 4); None where one isn't located."""
    phases, at = measured.phases, source_times(event)
    starts = {name: getattr(phases, f"{name}_s") for name in EVENT_PHASES}
    source = phase_starts(event)
    if any(t is None for t in starts.values()) or set(source) != set(EVENT_PHASES):
        return None
    length_s = at["end"].mid - at["start"].mid
    reference = {name: phase_fraction(t, 0.0, length_s) for name, t in source.items()}
    phi = {name: phase_fraction(t, phases.start_s, phases.end_s) for name, t in starts.items()}
    return phase_difference(phi, reference)
