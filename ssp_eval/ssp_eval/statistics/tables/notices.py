"""The notices that a reader must see before comparing any of a set of cells."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ssp_core import RULES_VERSION
from ssp_core.vocabulary import DOMAINS, PHASES
from ssp_eval.data.labels import LabelComparison
from ssp_eval.evaluate.clients.models import (
    ANSWERERS,
    BEST_CONSTANT,
    BLIND,
    CONDITIONS,
    REPEAT,
    TWIN,
    condition_of,
)
from ssp_eval.evaluate.store.admission import ADMITTED
from ssp_eval.evaluate.store.results import CellData, CellFacts
from ssp_eval.extract.language import NOT_READ
from ssp_eval.score.aggregate import domain_order
from ssp_eval.statistics.rows import (
    OK,
    CellRow,
    apart_across_runs,
    compared_labels,
    doubtful,
    entering,
    one_scale,
    over_what,
)
from ssp_eval.statistics.table import Column, Table, some
from ssp_eval.statistics.tables.scores import uneven

COMPARABILITY, STAND_IN, LEFT_OUT, CONTROLS, LABELS, LANGUAGE, MEASURED, RENDERER, CELL = (
    "comparability",
    "stand_in",
    "left_out",
    "controls",
    "labels",
    "language",
    "measured",
    "renderer",
    "cell",
)
OUTAGE, ACCEPTED, DECLARED, RULES = "outage", "accepted", "declared", "rules"
DRIVEN = "driven"


@dataclass(frozen=True)
class Notice:
    """One remark for the reader.

    Args:
        kind: comparability, stand_in, left_out, controls, labels, language, measured,
            renderer, outage, accepted, declared, rules, driven or cell.
        text: one or two sentences; of many names it holds the first and counts the rest.
        about: every name that it is about: recordings, cells or models.
        everywhere: it stands under every table, and first on the page.
    """

    kind: str
    text: str
    about: tuple[str, ...] = ()
    everywhere: bool = False


def notices(
    rows: Sequence[CellRow], cells: Sequence[CellData] = (), expected: Iterable[str] = ()
) -> list[Notice]:
    """List all notices, those under every table first.

    Args:
        rows: of all cells.
        cells: the cells behind the rows; none where only component scores are known.
        expected: scenarios that the campaign was planned with.
    """
    all_notices = [
        *_of_plan(rows, expected),
        *_of_rows(rows),
        *_comparability(rows, cells),
        *_label_plans(rows, cells),
        *_of_cells(cells),
    ]
    return sorted(all_notices, key=lambda notice: not notice.everywhere)


def everywhere(all_notices: Iterable[Notice]) -> tuple[str, ...]:
    """List the notices that stand under every table."""
    return tuple(notice.text for notice in all_notices if notice.everywhere)


def notice_table(all_notices: Sequence[Notice]) -> Table:
    """Return the notices as a table; in CSV and JSON with every name that each is about."""
    columns = (
        Column("kind", "kind", "text"),
        Column("text", "notice", "text"),
        Column("about", "about", "text", printed=False),
        Column("everywhere", "everywhere", "text", printed=False),
    )
    rows = tuple(
        (one.kind, one.text, "; ".join(one.about), "yes" if one.everywhere else "no")
        for one in all_notices
    )
    return Table("notices", "What to know before comparing", columns, rows)


def stand_ins(rows: Iterable[CellRow | CellFacts]) -> list[str]:
    """Return the recordings in which a program stands in for a vehicle."""
    return sorted({f"{row.scenario} / {row.domain}" for row in rows if row.stand_in})


def stand_in_text(recordings: Sequence[str]) -> str:
    """Return a sentence that no vehicle is in these recordings; empty where there are none."""
    if not recordings:
        return ""
    return f"Physical is a software stand-in here, not a vehicle: {some(recordings)}."


def _of_plan(rows: Sequence[CellRow], expected: Iterable[str]) -> Iterable[Notice]:
    if absent := sorted(set(expected) - {row.scenario for row in rows}):
        text = (
            f"Missing: no model was asked about {some(absent)}, which this campaign was planned "
            "with. All means are over the other scenarios."
        )
        yield Notice(LEFT_OUT, text, tuple(absent), everywhere=True)


def declared_texts(rows: Iterable[CellRow]) -> list[tuple[str, tuple[str, ...]]]:
    """Group recordings by the person who declares their domain, with the sentence that says so."""
    recordings: dict[tuple[str, str], set[str]] = {}
    for row in rows:
        if row.declared_by:
            where = recordings.setdefault((row.domain, row.declared_by), set())
            where.add(f"{row.scenario} / {row.domain}")
    return [
        (
            f"{domain.capitalize()} as declared by {who}: {some(sorted(names))}.",
            tuple(sorted(names)),
        )
        for (domain, who), names in sorted(recordings.items())
    ]


def domain_text(rows: Sequence[CellRow]) -> str:
    """Write what a caption must say of the recordings' domains; empty for nothing."""
    texts = (stand_in_text(stand_ins(rows)), *(text for text, _ in declared_texts(rows)))
    return " ".join(text for text in texts if text)


def outage_text(rows: Iterable[CellRow]) -> tuple[str, tuple[str, ...]]:
    """Write what outages cost, with the names of the cells; empty where they cost nothing."""
    lost = [row for row in rows if row.status == OK and row.lost]
    if not lost:
        return "", ()
    # Models first: of many names only some are printed.
    ordered = sorted(lost, key=lambda row: (row.control, *row.key))
    names = tuple(dict.fromkeys(" / ".join(row.key) for row in ordered))
    count = sum(row.lost for row in lost)
    times = "1 label time, which counts as a missing output"
    if count > 1:
        times = f"{count} label times, which count as missing outputs"
    return (
        f"Outage: the bridge, server or network gave no answer at {times}. Means over these cells "
        f"include the outage: {some(names, '; ')}. Ask again with --retry-errors."
    ), names


def caption_text(rows: Sequence[CellRow]) -> str:
    """Write what the caption of a figure must say beside the figure; empty for nothing."""
    return " ".join(text for text in (domain_text(rows), outage_text(rows)[0]) if text)


def lead(rows: Sequence[CellRow]) -> str:
    """Describe the cells and what a difference between two of them is, without naming a cause."""
    scenarios, domains = {row.scenario for row in rows}, {row.domain for row in rows}
    models = {row.model for row in rows if not row.control}
    events = "one event" if len(scenarios) == 1 else f"{len(scenarios)} events"
    *others, last = sorted(domains, key=domain_order)
    domains_text = f"the {', '.join(others)} and {last} domains" if others else f"the {last} domain"
    sentences = [
        "Scores of driving vision–language–action models that were shown forward video of "
        f"{events}, recorded in {domains_text}."
    ]
    if len(models) > 1:
        sentences.append("A difference between two models holds for these recordings only.")
    if len(domains) > 1:
        sentences.append(
            "Each domain has one recording of each event, so a difference between two domains is "
            "a difference between recordings; nothing here shows which of their properties causes "
            "it."
        )
    return " ".join(sentences)


def _of_rows(rows: Sequence[CellRow]) -> Iterable[Notice]:
    if over := sorted(over_what(rows)):
        text = (
            f"Macro rows: each is a published mean over {' and '.join(f'{name}s' for name in over)}"
            " and counts as one value, however many cells it is over. Those cells aren't known "
            "here: they can't be analysed one by one, and may differ between models."
        )
        yield Notice(COMPARABILITY, text, (), everywhere=True)
    if names := stand_ins(rows):
        yield Notice(STAND_IN, stand_in_text(names), tuple(names), everywhere=True)
    for text, about in declared_texts(rows):
        yield Notice(DECLARED, text, about, everywhere=True)
    text, about = outage_text(rows)
    if text:
        yield Notice(OUTAGE, text, about, everywhere=True)
    for status in sorted({row.status for row in rows if row.status != OK}):
        names = sorted({" / ".join(row.key) for row in rows if row.status == status})
        cells = "1 cell enters" if len(names) == 1 else f"{len(names)} cells enter"
        text = f"{status.capitalize()}: {cells} no mean: {some(names, '; ')}."
        yield Notice(LEFT_OUT, text, tuple(names))
    if absent := _absent(rows):
        missing = "1 cell is" if len(absent) == 1 else f"{len(absent)} cells are"
        text = (
            f"Not evaluated: {missing} missing; these models weren't asked about these "
            f"recordings: {some(absent, '; ')}."
        )
        yield Notice(LEFT_OUT, text, tuple(absent))
    scored = [row.cell() for row in entering(rows)]
    yield from _of_thresholds(rows)
    for text, about in doubtful(rows):
        yield Notice(COMPARABILITY, text, about, everywhere=True)
    for subject in ("model", "domain"):
        for text in uneven(scored, subject):
            yield Notice(COMPARABILITY, text)
    yield from _of_controls(rows)
    if nulls := sorted({" / ".join(row.key) for row in rows if row.ivcs_nulls}):
        text = f"A component has no denominator and counts as 0 in IVCS: {some(nulls)}."
        yield Notice(CELL, text, tuple(nulls))


def _of_thresholds(rows: Sequence[CellRow]) -> Iterable[Notice]:
    scored = [row for row in rows if row.status == OK]
    others = sorted({" / ".join(row.key) for row in scored if row.thresholds})
    if not others:
        return
    which = "all cells" if all(row.thresholds for row in scored) else some(others, "; ")
    text = f"Scored with thresholds other than METHOD's: {which}."
    same_scale = one_scale(scored)
    if len(same_scale) < len(scored):
        text += (
            " Cells with different thresholds aren't averaged together: "
            f"{len(scored) - len(same_scale)} of them enter no mean."
        )
    yield Notice(COMPARABILITY, text, tuple(others), everywhere=True)


def _absent(rows: Sequence[CellRow]) -> list[str]:
    """Return models that weren't asked about a recording that another was asked about.

    Not every recording has twins, or is asked about again: that one has none isn't a gap.
    """
    there = {row.key for row in rows}
    clips = dict.fromkeys((row.scenario, row.domain) for row in rows)
    models = dict.fromkeys(
        row.model
        for row in rows
        if row.model != BEST_CONSTANT and not condition_of(row.model)[1].startswith((TWIN, REPEAT))
    )
    return [
        " / ".join((*clip, model))
        for clip in clips
        for model in models
        if (*clip, model) not in there
    ]


def _of_controls(rows: Sequence[CellRow]) -> Iterable[Notice]:
    controls = sorted({row.model for row in rows if row.control})
    models = sorted({row.model for row in rows if not row.control})
    if not set(controls) - {BEST_CONSTANT}:
        text = (
            "These cells have no controls: nothing here shows that a score comes from seeing, or "
            "that the harness scores perfect answers 1 and missing answers 0."
        )
        yield Notice(CONTROLS, text, (), everywhere=True)
        return
    text = (
        f"{controls[0]} is a control of the harness, not a model; means and ranks leave it out."
        if len(controls) == 1
        else f"{some(controls)} are controls of the harness, not models; means and ranks "
        "leave them out."
    )
    if blind := [name for name in controls if condition_of(name)[1] == BLIND]:
        text += f" Blind, asked without pictures: {some(blind)}."
    yield Notice(CONTROLS, text, tuple(controls))
    spoilt = {condition_of(name) for name in controls}
    # Answerers of our own see no frame, also where they stand in for models.
    lacking = [
        name
        for name in models
        if name not in ANSWERERS and not all((name, one) in spoilt for one in CONDITIONS)
    ]
    if lacking:
        text = (
            f"Not asked with black and shuffled frames: {some(lacking)}. Nothing here shows that "
            "their scores come from seeing."
        )
        yield Notice(CONTROLS, text, tuple(lacking))


def _of_cells(cells: Sequence[CellData]) -> Iterable[Notice]:
    every = _recordings(cells)
    yield from _outside(cells)
    yield from _of_renderers(cells)
    yield from _of_carla(cells)
    yield from _of_rules(cells)
    yield from _of_drivers(cells)
    for finding in sorted({name for cell in cells for name in cell.facts.clip.accepted}):
        names = _recordings(cell for cell in cells if finding in cell.facts.clip.accepted)
        text = f"Accepted unchanged at import: {finding} in {some(names)}."
        yield Notice(ACCEPTED, text, tuple(names), everywhere=True)
    if names := _recordings(cell for cell in cells if cell.facts.labels_proposed):
        text = (
            "The labels are as proposed from ground truth; no person has reviewed them: "
            f"{'all recordings' if names == every else some(names)}."
        )
        yield Notice(LABELS, text, tuple(names))
    if names := sorted({c.model for c in cells if any(NOT_READ in note for note in c.notes)}):
        text = (
            f"Texts {NOT_READ} (they read English): {some(names)}. Their semantics and actions "
            "count as missing, so these scores aren't comparable with others; the notes of each "
            "cell give the number of texts."
        )
        yield Notice(LANGUAGE, text, tuple(names), everywhere=True)
    for what, names in _assumed(cells).items():
        yield Notice(MEASURED, f"Not measured: {what} of {some(names)}.", tuple(names))
    for cell in cells:
        name = f"{cell.scenario} / {cell.domain} / {cell.model}"
        if cell.score is not None and (ignored := len(cell.score.details.unmatched_records)):
            records = "1 record matches" if ignored == 1 else f"{ignored} records match"
            ignoring = "is ignored" if ignored == 1 else "are ignored"
            yield Notice(CELL, f"{name}: {records} no label and {ignoring}.", (name,))
        for note in cell.notes:
            yield Notice(CELL, f"{name}: {note}", (name,))


def _comparability(rows: Sequence[CellRow], cells: Sequence[CellData]) -> Iterable[Notice]:
    """Yield notices on comparability within each run, and of versions of K* over all runs.

    Another run may have other recordings, but of the same event.
    """
    runs = [
        (row.run, cell)
        for row, cell in zip(rows, cells, strict=bool(cells))
        if cell.score is not None
    ]
    mixed: dict[tuple[str, ...], list[str]] = {}
    for key, what in (("bag", "different recordings"), ("labels", "different labels")):
        hashes = (
            (run, f"{cell.scenario} / {cell.domain}", cell.facts.hashes.get(key))
            for run, cell in runs
        )
        if names := _several(hashes):
            mixed.setdefault(tuple(names), []).append(what)
    for about, kinds in mixed.items():
        text = (
            f"Not comparable: the cells of {some(about)} use {' and '.join(kinds)}. Evaluate all "
            "models again with the same ones."
        )
        yield Notice(COMPARABILITY, text, about, everywhere=True)
    if names := _several(("", cell.scenario, cell.facts.event_version) for _, cell in runs):
        text = f"Not comparable: the cells of {some(names)} use different versions of K*."
        yield Notice(COMPARABILITY, text, tuple(names), everywhere=True)
    extractors = {cell.facts.hashes.get("extractor") for _, cell in runs}
    if len(extractors) > 1:
        text = (
            f"Not comparable: the texts of these cells were read by {len(extractors)} different "
            "extractors (different versions, or with and without a reader or LLM). Evaluate all "
            "models again in the same way; stored answers are reused."
        )
        yield Notice(COMPARABILITY, text, (), everywhere=True)


def _several(facts: Iterable[tuple[str, str, str | None]]) -> list[str]:
    """Name those that have several values in one run.

    Args:
        facts: run, name and value.
    """
    by_run_and_name: dict[tuple[str, str], set[str | None]] = {}
    for run, name, value in facts:
        by_run_and_name.setdefault((run, name), set()).add(value)
    return sorted({name for (_, name), values in by_run_and_name.items() if len(values) > 1})


def _outside(cells: Sequence[CellData]) -> Iterable[Notice]:
    """Yield the scored recordings that stay out of domain means, by what the audit says of them."""
    by_admission: dict[str, list[CellData]] = {}
    for cell in cells:
        if cell.score is not None and cell.admission != ADMITTED:
            by_admission.setdefault(cell.admission, []).append(cell)
    for status, group in sorted(by_admission.items()):
        names = _recordings(group)
        why = (
            f"Unpaired: the transfer audit refused a partner of {some(names)}."
            if status == "unpaired"
            else f"Unaudited: no transfer audit was given for {some(names)}, so nothing shows that "
            "they show the same event."
        )
        text = f"{why} They are scored but left out of domain means."
        yield Notice(LEFT_OUT, text, tuple(names), everywhere=True)


def _label_plans(rows: Sequence[CellRow], cells: Sequence[CellData]) -> Iterable[Notice]:
    """Note how many labels each phase has, and which domains don't compare by them (METHOD 5.2b).

    Within each run, as _comparability, and over all runs where each is comparable by itself.
    """
    runs: dict[str, list[CellData]] = {}
    for row, cell in zip(rows, cells, strict=bool(cells)):
        runs.setdefault(row.run, []).append(cell)
    order = "/".join(PHASES)
    comparisons = {
        (name, plan): None for of in runs.values() for name, plan in compared_labels(of).items()
    }
    apart = apart_across_runs(cells) if len(runs) > 1 else set()
    for scenario in sorted(apart - {name for name, one in comparisons if _is_apart(one)}):
        text = (
            f"Not comparable: the labels of {scenario} lie at different places within the phases "
            "of each domain in different runs. Its recordings are scored but left out of domain "
            "means; `ssp labels new SYN SIM PHY` plans their labels together."
        )
        yield Notice(COMPARABILITY, text, (scenario,), everywhere=True)
    for scenario, comparison in comparisons:
        if not _is_apart(comparison):
            clock = comparison.domains > 1 and not comparison.aligned
            aligned = "; the labels are not phase-aligned" if clock else ""
            text = f"Labels of {scenario} in {order}: {comparison.text}{aligned}."
            yield Notice(LABELS, text, (scenario,))
            continue
        text = (
            f"Not comparable: the labels of {scenario} lie at different places within the phases "
            f"of each domain ({order}: {comparison.text}). Its recordings are scored but left out "
            "of domain means; `ssp labels new SYN SIM PHY` plans their labels together."
        )
        yield Notice(COMPARABILITY, text, (scenario,), everywhere=True)


def _is_apart(comparison: LabelComparison) -> bool:
    return comparison.domains > 1 and not comparison.comparable


def _of_renderers(cells: Sequence[CellData]) -> Iterable[Notice]:
    """Yield the domains whose pictures one renderer drew (METHOD 4.4)."""
    domains_by_renderer: dict[str, set[str]] = {}
    for cell in cells:
        if cell.facts.clip.renderer is not None:
            domains_by_renderer.setdefault(cell.facts.clip.renderer, set()).add(cell.domain)
    for renderer, domains in sorted(domains_by_renderer.items()):
        if len(domains) > 1:
            text = (
                f"{renderer[0].upper()}{renderer[1:]} drew the pictures of {len(domains)} domains: "
                f"{', '.join(name for name in DOMAINS if name in domains)}. Differences between "
                "these domains say nothing about pictures from a camera or another renderer."
            )
            yield Notice(RENDERER, text, tuple(sorted(domains)), everywhere=True)


def _of_carla(cells: Sequence[CellData]) -> Iterable[Notice]:
    """Yield bodies of CARLA, which aren't of the size or the physics that the run reckons with."""
    bodies_by_recording = {
        (cell.scenario, cell.domain): cell.facts.clip.carla
        for cell in cells
        if cell.facts.clip.carla
    }
    for (scenario, domain), bodies in sorted(bodies_by_recording.items()):
        description = ". ".join(
            f"{name[0].upper()}{name[1:]}: {text}" for name, text in bodies.items()
        )
        text = f"CARLA drew or moved {scenario} in {domain}. {description}."
        yield Notice(RENDERER, text, (scenario,), everywhere=True)


def _of_drivers(cells: Sequence[CellData]) -> Iterable[Notice]:
    recordings_by_driver: dict[str, set[str]] = {}
    for cell in cells:
        if driver := cell.facts.clip.driven_by:
            recordings_by_driver.setdefault(driver, set()).add(f"{cell.scenario} / {cell.domain}")
    for driver, names in sorted(recordings_by_driver.items()):
        text = (
            f"{some(sorted(names))}: {driver} drove the VUT. Other models are asked about the "
            "situations that it met, and the recording belongs to no domain."
        )
        yield Notice(DRIVEN, text, tuple(sorted(names)), everywhere=True)


def _of_rules(cells: Sequence[CellData]) -> Iterable[Notice]:
    """Yield cells and imports that were made before and after an update of the rules."""
    earlier = sorted(
        f"{cell.scenario} / {cell.domain} / {cell.model}"
        for cell in cells
        if cell.facts.rules_version < RULES_VERSION
    )
    if earlier:
        every = "all cells" if len(earlier) == len(cells) else some(earlier, "; ")
        text = f"Scored by the rules of an earlier version: {every}."
        if len(earlier) < len(cells):
            text += " They aren't comparable with the other cells."
        yield Notice(RULES, f"{text} {_UPDATING}", tuple(earlier), everywhere=True)
    imports = _recordings(
        cell
        for cell in cells
        if cell.facts.clip.import_rules is not None and cell.facts.clip.import_rules < RULES_VERSION
    )
    if imports:
        text = f"Imported by the rules of an earlier version: {some(imports)}. {_UPDATING}"
        yield Notice(RULES, text, tuple(imports), everywhere=True)


_UPDATING = "docs/updating.md says what to make again."


def _recordings(cells: Iterable[CellData]) -> list[str]:
    return sorted({f"{cell.scenario} / {cell.domain}" for cell in cells})


def _assumed(cells: Sequence[CellData]) -> dict[str, list[str]]:
    """Return the recordings by quantities that aren't measured in them, and their replacements."""
    recordings: dict[str, set[str]] = {}
    for cell in cells:
        parts = (("ego motion", cell.facts.clip.ego), ("camera", cell.facts.clip.camera))
        if what := " and ".join(f"{name} ({how})" for name, how in parts if how != "measured"):
            recordings.setdefault(what, set()).add(f"{cell.scenario} / {cell.domain}")
    return {what: sorted(names) for what, names in sorted(recordings.items())}
