"""Arm ``structure``: the compiler, with all of K* (METHOD 2)."""

from __future__ import annotations

from ssp_core.run_file.model import RunSpec
from ssp_eval.ablation.ground import BUDGET, Ground, NoRun, executed
from ssp_scenario_manager.compile.place import MOST_RUN, Order, realise
from ssp_scenario_manager.compile.retrieval import score_blocks
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.scenarios.base import CannotPlace

# A plan is run without a response of the VUT, and with the driver of the simulation.
_SESSIONS_OF_PLAN = 2


def by_structure(event: Event, version: str, ground: Ground) -> tuple[RunSpec, str]:
    """Return the compiler's run for a place, and the block.

    Of blocks that score alike the first by its id is taken, as a person might. As many blocks are
    tried as the tuning budget has sessions for.

    Raises:
        NoRun: no block of the place fits.
    """
    blocks = {block.block_id: block for block in ground.blocks}
    scores = score_blocks(event, ground.area.library)
    order = Order(event, version, ground.area, "sumo", 1, {})
    why = "; ".join(scores[0].reasons) if scores else "it has no blocks"
    fits = [score for score in scores if score.eligible]
    for k, score in enumerate(fits[: BUDGET // (MOST_RUN * _SESSIONS_OF_PLAN)]):
        try:
            realisation = realise(order, blocks[score.block])
        except CannotPlace as error:
            why = str(error) if k == 0 else why
            continue
        return executed(realisation.task.run), score.block
    raise NoRun(why)
