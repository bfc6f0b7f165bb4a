"""The tables of "What moved the answer"."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from statistics import fmean

from ssp_eval.causes.answers import Answer, CellAnswers, cause_of
from ssp_eval.causes.effects import TRAJECTORY, Effect, Verdict
from ssp_eval.causes.findings import Finding, MovedAnswers
from ssp_eval.statistics.table import Column, Table, Value

FINDINGS, SLOTS, PATHS, AGREEMENT = (
    "moved_findings",
    "moved_slots",
    "moved_trajectories",
    "moved_agreement",
)
_LEFT_OUT = (
    "The unit is the recording: its label times are averaged, since neighbouring answers are "
    "alike. Label times with a missing answer are left out."
)
_TESTED = (
    "more, fewer: recordings in which the cause changes more than the control (or the repeated "
    "question) does, and less. Holm: over all tests of a model in which anything differs. A test "
    "can reject from about ten recordings on; with fewer, differences are shown untested, "
    "provided that the control and the repeated question change nothing."
)
_MEANING = ("docs/twins.md says what such an effect shows, and what it doesn't.",)


def moved_tables(moved: MovedAnswers) -> list[Table]:
    """Return all tables of what moved the answers."""
    return [
        findings_table(moved.findings),
        slots_table(moved.effects),
        paths_table(moved.effects),
        agreement_table(moved.cells),
    ]


def findings_table(findings: Sequence[Finding]) -> Table:
    """Return the table of findings, one row per model."""
    rows = [
        (one.model, one.word.value, "yes" if one.tested else "no", one.text) for one in findings
    ]
    columns = (
        Column("model", "model", "text"),
        Column("finding", "finding", "text"),
        Column("tested", "tested", "text"),
        Column("evidence", "evidence", "text"),
    )
    return Table(FINDINGS, "What moved the answers of each model", columns, tuple(rows), _MEANING)


_KEYS = (
    Column("model", "model", "text"),
    Column("cause", "changed", "text"),
    Column("condition", "cause", "text", printed=False),
)
_UNITS = (
    Column("n", "recordings", "count"),
    Column("labels", "label times", "count"),
)
_TESTS = (
    Column("more", "more", "count"),
    Column("fewer", "fewer", "count"),
    Column("p", "p", "p"),
)
_LAST = (
    Column("p_holm", "p Holm", "p"),
    Column("verdict", "verdict", "text"),
    Column("control", "control", "text", printed=False),
    Column("p_least", "least p", "p", printed=False),
)


def slots_table(effects: Iterable[Effect]) -> Table:
    """Tabulate the effect of each cause on each slot of the text."""
    columns = (
        *_KEYS,
        Column("slot", "slot", "text"),
        *_UNITS,
        Column("given", "given"),
        Column("changed", "differs"),
        Column("by_control", "by the control"),
        Column("by_repeat", "asked again"),
        Column("effect", "effect", "signed"),
        Column("low", "95 % from", "signed"),
        Column("high", "to", "signed"),
        *_TESTS,
        Column("p_mid", "mid-p", "p"),
        *_LAST,
    )
    rows: list[tuple[Value, ...]] = [
        (
            *_begin(e)[:3],
            e.output,
            *_begin(e)[3:],
            e.coverage,
            e.changed,
            e.changed_by_control,
            e.changed_by_repeat,
            e.size,
            e.interval.low,
            e.interval.high,
            *_test(e),
            None if e.test is None else e.test.p_mid,
            *_end(e),
        )
        for e in effects
        if e.output != TRAJECTORY and e.verdict is not Verdict.NOT_GIVEN
    ]
    notes = (
        "differs: share of label times at which the slot differs from the factual answer; by the "
        "control: that share under an irrelevant change; asked again: that share when the "
        "factual question is repeated. The effect is the first minus the larger of the other "
        "two, with Newcombe's interval of paired shares; without a control it is the "
        "share itself, with Wilson's. Slots that a model never gives are left out.",
        _LEFT_OUT,
        "p: McNemar's exact test.",
        _TESTED,
        *_MEANING,
    )
    return Table(SLOTS, "What moved the text, by slot", columns, tuple(rows), notes)


def paths_table(effects: Iterable[Effect]) -> Table:
    """Tabulate the effect of each cause on the trajectory."""
    columns = (
        *_KEYS,
        *_UNITS,
        Column("given", "given"),
        Column("moved_m", "moved (m)", "seconds"),
        Column("by_control_m", "by the control (m)", "seconds"),
        Column("by_repeat_m", "asked again (m)", "seconds"),
        Column("effect_m", "effect (m)", "seconds"),
        Column("low_m", "95 % from (m)", "seconds"),
        Column("high_m", "to (m)", "seconds"),
        Column("per_metre", "per metre", "signed"),
        Column("per_metre_low", "95 % from", "signed"),
        Column("per_metre_high", "to", "signed"),
        *_TESTS,
        *_LAST,
    )
    rows: list[tuple[Value, ...]] = [
        (
            *_begin(e),
            e.coverage,
            e.changed,
            e.changed_by_control,
            e.changed_by_repeat,
            e.size,
            e.interval.low,
            e.interval.high,
            e.per_metre,
            e.per_metre_interval.low,
            e.per_metre_interval.high,
            *_test(e),
            *_end(e),
        )
        for e in effects
        if e.output == TRAJECTORY
    ]
    notes = (
        "moved: mean distance between the trajectory and the factual one, over its first 3 s or "
        "as long as all of them last. The effect is Hodges and Lehmann's estimate of how much "
        "further the cause moves it than the control does, or than the repeated question where "
        "that moves it more; per metre: over the length of the factual trajectory.",
        _LEFT_OUT,
        "p: Wilcoxon's signed rank.",
        _TESTED,
        *_MEANING,
    )
    return Table(PATHS, "What moved the trajectory", columns, tuple(rows), notes)


def _begin(effect: Effect) -> tuple[Value, ...]:
    cause = effect.cause
    return effect.model, cause.words, cause.key, effect.recordings, effect.labels


def _test(effect: Effect) -> tuple[Value, ...]:
    test = effect.test
    return (None, None, None) if test is None else (test.more, test.fewer, test.p)


def _end(effect: Effect) -> tuple[Value, ...]:
    least = None if effect.test is None else effect.test.p_least
    return effect.p_holm, effect.verdict.value, effect.control or "no control", least


def agreement_table(cells: Iterable[CellAnswers]) -> Table:
    """Tabulate how often text and trajectory state the same actions, factual and by cause."""
    groups: dict[tuple[str, str], list[Answer | None]] = {}
    words: dict[str, str] = {}
    for cell in cells:
        cause = cause_of(cell.condition)
        key = cell.condition if cause is None else cause.key
        words[key] = cause.words if cause else "nothing, asked again" if key else "nothing"
        groups.setdefault((cell.model, key), []).extend(cell.answers.values())
    rows = []
    for (model, key), answers in sorted(groups.items()):
        agreements = [a.agrees for a in answers if a is not None and a.agrees is not None]
        rows.append(
            (
                model,
                words[key],
                key,
                len(answers),
                len(agreements),
                sum(agreements) / len(answers) if answers else None,
                fmean(agreements) if agreements else None,
            )
        )
    columns = (
        *_KEYS,
        Column("n", "label times", "count"),
        Column("both", "with both", "count"),
        Column("atc_eff", "ATC_eff"),
        Column("agreement", "of those with both"),
    )
    notes = (
        "ATC_eff: share of all label times at which the text's actions are those of the "
        "trajectory (METHOD 6.8); the last column leaves out those at which one of them says "
        "none. No label is used.",
    )
    return Table(AGREEMENT, "Do text and trajectory agree?", columns, tuple(rows), notes)
