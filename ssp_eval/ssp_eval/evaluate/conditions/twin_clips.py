"""The twins beside a recording, open to be asked about in its place (docs/twins.md)."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import ExitStack
from dataclasses import replace

from ssp_core import console
from ssp_core.errors import InputError
from ssp_eval.evaluate.clients.models import TWIN
from ssp_eval.evaluate.store.cell_file import LabelledClip, TwinClip
from ssp_eval.recordings.clip import Clip
from ssp_eval.twins.files import TwinRecord, bag_of, read_set, usable_twins

_REMEDY = "make the twins of {} anew with `ssp twins`"


def with_twins(
    stack: ExitStack, labelled: LabelledClip, conditions: Collection[str] = ()
) -> LabelledClip:
    """Return the recording with the twins that lie beside it, by condition.

    A twin whose audit doesn't hold isn't asked about, and a note says so.

    Args:
        stack: that closes the twins' bags.
        labelled: the recording with its labels.
        conditions: of the twins that are wanted; empty: all of them.

    Raises:
        InputError: they are of another recording, or one isn't the bag that was audited.
    """
    clip = labelled.clip
    twin_set = read_set(clip.path)
    for one in twin_set.twins if twin_set is not None and not conditions else ():
        if not one.audit.holds:
            why = "; ".join(one.audit.reasons) or "no reason is given"
            place = bag_of(clip.path, one.identity.name)
            console.note(f"{place}: isn't asked about, its audit doesn't hold: {why}")
    twins = {
        name: _opened(stack, clip, one)
        for one in usable_twins(clip.path, clip.provenance.bag_sha256)
        if (name := TWIN + one.identity.name) in conditions or not conditions
    }
    return replace(labelled, twins=twins)


def _opened(stack: ExitStack, clip: Clip, twin: TwinRecord) -> TwinClip:
    name = twin.identity.name
    opened = stack.enter_context(Clip(bag_of(clip.path, name)))
    facts = opened.provenance
    if facts.bag_sha256 != twin.bag_sha256:
        raise InputError(
            f"isn't the bag that was audited as the twin {name} ({twin.bag_sha256})",
            file=opened.path,
            value=facts.bag_sha256,
            remedy=_REMEDY.format(clip.path),
        )
    if opened.start_ns != clip.start_ns:
        raise InputError(
            f"begins at another time than {clip.path} ({clip.start_ns} ns)",
            file=opened.path,
            value=opened.start_ns,
            remedy=_REMEDY.format(clip.path),
        )
    opened.crop_to(clip.crop)
    return TwinClip(name, twin.identity.words, twin.bag_sha256, opened)
