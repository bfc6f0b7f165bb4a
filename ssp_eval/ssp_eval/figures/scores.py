"""The data that figures read from rows: cells, groups of them, and names in drawing order."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from ssp_eval.score.aggregate import (
    BY_DOMAIN,
    BY_MODEL,
    BY_SCENARIO_DOMAIN,
    BY_SCENARIO_MODEL,
    Cell,
    Mean,
    domain_order,
    means,
)
from ssp_eval.statistics.constants import (
    BELOW,
    CONSTANT,
    MARK,
    Place,
    constant_means,
    constants_in,
    is_below,
)
from ssp_eval.statistics.rows import OK, CellRow, entering, merged, one_scale, over_what
from ssp_eval.statistics.table import counted
from ssp_eval.statistics.tables.scores import run_notes, uneven

Group = Mapping[str, Mean]


@dataclass(frozen=True)
class Scores:
    """The rows of a report, and what is computed from those that may enter means.

    Args:
        rows: all, in any order; no figure depends on it.
    """

    rows: tuple[CellRow, ...]

    @cached_property
    def matrix_rows(self) -> tuple[CellRow, ...]:
        """One row per cell for the matrix: runs together, controls and what has no scores too."""
        scored = merged(sorted((r for r in self.rows if r.status == OK), key=_run_order))
        keys = {row.key for row in scored}
        others = {row.key: row for row in sorted(self.rows, key=_run_order) if row.key not in keys}
        return tuple(
            sorted(
                (*scored, *others.values()),
                key=lambda r: (r.scenario, domain_order(r.domain), r.control, r.model.casefold()),
            )
        )

    @cached_property
    def entering(self) -> tuple[CellRow, ...]:
        """One row per cell that may enter means and ranks."""
        return tuple(sorted(entering(sorted(self.rows, key=_run_order)), key=lambda r: r.key))

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """The same for ssp_eval.score.aggregate."""
        return tuple(row.cell() for row in self.entering)

    @cached_property
    def over(self) -> frozenset[str]:
        """Return what the rows are published means over; empty for cells."""
        return over_what(self.rows)

    @cached_property
    def by_domain(self) -> dict[str, Group]:
        """Means per domain, over admitted cells."""
        groups = {domain: group for (domain,), group in means(self.cells, BY_DOMAIN).items()}
        return {domain: groups[domain] for domain in sorted(groups, key=domain_order)}

    @cached_property
    def by_scenario_domain(self) -> dict[tuple[str, str], Group]:
        """Means per scenario and domain, over admitted cells."""
        return {(s, d): group for (s, d), group in means(self.cells, BY_SCENARIO_DOMAIN).items()}

    @cached_property
    def by_scenario_model(self) -> dict[tuple[str, str], Group]:
        """Means per scenario and model."""
        return {(s, m): group for (s, m), group in means(self.cells, BY_SCENARIO_MODEL).items()}

    @cached_property
    def by_model(self) -> dict[str, Group]:
        """Means per model, the best by IVCS first."""
        groups = {model: group for (model,), group in means(self.cells, BY_MODEL).items()}
        order = sorted(groups, key=lambda m: (-(groups[m]["ivcs"].value or 0.0), m.casefold(), m))
        return {model: groups[model] for model in order}

    @cached_property
    def constants(self) -> dict[Place, Cell]:
        """The best blind constant's cell of each scenario and domain; empty: it is unknown."""
        return constants_in(one_scale(self.rows))

    def constant(self, *by: str) -> dict[tuple[str, ...], float | None]:
        """Return the constant's mean IVCS over the same cells as each group's."""
        group_means = constant_means(self.cells, self.constants, by)
        return {key: mean.value for key, mean in group_means.items()}

    def is_below(self, row: CellRow) -> bool:
        """Tell whether a model scores less on a recording than its best blind constant."""
        constant = self.constants.get((row.scenario, row.domain))
        return (
            constant is not None and not row.control and is_below(row.ivcs, constant.score["ivcs"])
        )

    def below(self, *by: str) -> frozenset[tuple[str, ...]]:
        """Return groups whose mean IVCS is less than the constant's over the same cells."""
        constant = self.constant(*by)
        return frozenset(
            key
            for key, group in means(self.cells, by).items()
            if is_below(group["ivcs"].value, constant.get(key))
        )

    @cached_property
    def places(self) -> frozenset[Place]:
        """Scenario and domain of the cells that enter means."""
        return frozenset((cell.scenario, cell.domain) for cell in self.cells)

    def constant_text(self, look: str) -> str:
        """Return a sentence of the line that is drawn of the constant; empty where there is none.

        Args:
            look: how it looks.
        """
        if not self.constants:
            return ""
        return (
            f"{look}: the {CONSTANT}, the one answer of each scenario that scores most over its "
            f"recordings without looking; it has no rank. {MARK}: {BELOW}."
        )

    @cached_property
    def scenarios(self) -> tuple[str, ...]:
        """List the scenarios of the cells that enter means."""
        return tuple(sorted({row.scenario for row in self.entering}))

    @cached_property
    def facts(self) -> dict[str, CellRow]:
        """Return by model a row that states its parameters and architecture."""
        return {row.model: row for row in reversed(self.entering)}

    def lost_runs(self, keys: Collection[tuple[str, str, str]]) -> list[CellRow]:
        """Return refused and failed runs of cells that other runs gave scores."""
        scored = {row.key for row in self.rows if row.status == OK} & set(keys)
        lost = (row for row in self.rows if row.status != OK and row.key in scored)
        return sorted(lost, key=_run_order)

    @cached_property
    def left_out(self) -> str:
        """Say what the means leave out and take together, in the words of the tables."""
        return " ".join(run_notes(self.rows))

    @cached_property
    def unadmitted(self) -> str:
        """A sentence where domain means leave out cells (METHOD 4)."""
        count = sum(not cell.admitted for cell in self.cells)
        if not count:
            return ""
        cells = counted(count, "cell")
        return (
            "Left out, since the audit didn't admit the recording or there was none, or since its "
            f"labels don't compare with those of other domains: {cells}."
        )

    def uneven(self, subject: str) -> str:
        """Return a sentence where the models or domains don't have the same cells."""
        return " ".join(uneven(self.cells, subject))

    def n_text(self, rows: Sequence[CellRow] | None = None) -> str:
        """Describe how many cells, scenarios, domains and models a figure is made of."""
        rows = self.entering if rows is None else rows
        if self.over:
            over = " and ".join(f"{name}s" for name in sorted(self.over))
            return f"{counted(len(rows), 'published mean')} over {over}"
        counts = (
            (len(rows), "cell"),
            (len({r.scenario for r in rows}), "scenario"),
            (len({r.domain for r in rows}), "domain"),
            (len({r.model for r in rows}), "model"),
        )
        return ", ".join(counted(count, word) for count, word in counts)


def _run_order(row: CellRow) -> tuple[tuple[str, str, str], str, int]:
    return row.key, row.run, -1 if row.seed is None else row.seed


def pareto_front(points: Mapping[str, tuple[float, float]]) -> list[str]:
    """Return names of the points that no other is at least as good as in both and better in one.

    Args:
        points: by name, larger is better in both.

    Returns:
        From left to right; equal points are all in it.
    """
    # Means that are equal but for their last digit are equal points.
    points = {name: (round(x, 12), round(y, 12)) for name, (x, y) in points.items()}
    front: list[str] = []
    best = float("-inf")
    # From the right: a point is in front when it is higher than all to its right.
    order = sorted(points, key=lambda name: (-points[name][0], -points[name][1], name))
    for name in order:
        y = points[name][1]
        if y > best or (front and points[name] == points[front[-1]]):
            front.append(name)
            best = y
    return front[::-1]


def words(name: str) -> str:
    """Return a name of the vocabulary as it stands in a figure."""
    return name.replace("_", " ")


def listed(names: Iterable[str]) -> str:
    """Return names as a list in a sentence."""
    return ", ".join(names) or "none"
