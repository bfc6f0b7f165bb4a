"""Frames that repeat the picture before them, as a recorder leaves them that outruns its camera.

They are no frames of their own: pairs are chosen among the others, each at the time at which its
picture is first there. A picture that lasts longer than METHOD 4.3b allows stays as it is, since
nothing moved in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from ssp_eval.pictures.footage import Float32, spread
from ssp_eval.recordings.sight import Moment

# Slower, successive pictures may be alike anyway.
_MOVING_MPS = 2.0
# In grey levels of small pictures; and of what others change, where that is less. Encoders leave
# up to 0.15 between a frame and its repetition, frames of a moving camera differ by 0.9 or more.
_SAME_LEVELS, _SAME_SHARE = 0.4, 0.2
# A picture that stays for longer is a camera that stands still.
LONGEST_S = 0.3
# From this share of repeated frames on all frames are gone through.
_FREQUENT_SHARE = 0.2
_SAMPLES = 24


def sampled_frames(moments: Sequence[Moment], vut_id: str) -> set[int]:
    """Choose frames that tell whether a recording repeats some: short runs, evenly spread."""
    moving = [k for k in range(2, len(moments)) if _moves(moments[k], vut_id)]
    return {k - back for k in spread(moving, _SAMPLES) for back in (0, 1, 2)}


def has_many_repeats(small: Mapping[int, Float32], moments: Sequence[Moment], vut_id: str) -> bool:
    """Tell whether many of some frames repeat the one before."""
    differences = _differences(small, moments, vut_id)
    same = _same(differences)
    return bool(differences) and len(same) >= _FREQUENT_SHARE * len(differences)


def repeated_frames(
    small: Mapping[int, Float32], moments: Sequence[Moment], vut_id: str
) -> frozenset[int]:
    """Return the indices of frames that repeat the picture before them.

    Args:
        small: small pictures by index into ``moments``.
        moments: frames with their states.
        vut_id: id of the VUT.
    """
    runs: list[list[int]] = []  # each without the frame that it repeats
    for index in sorted(_same(_differences(small, moments, vut_id))):
        if runs and runs[-1][-1] == index - 1:
            runs[-1].append(index)
        else:
            runs.append([index])
    short = (
        run for run in runs if moments[run[-1]].t_s - moments[run[0] - 1].t_s <= LONGEST_S + 1e-6
    )
    return frozenset(index for run in short for index in run)


def _moves(moment: Moment, vut_id: str) -> bool:
    state = moment.states.get(vut_id)
    return state is not None and abs(state.speed_mps) >= _MOVING_MPS


def _differences(
    small: Mapping[int, Float32], moments: Sequence[Moment], vut_id: str
) -> dict[int, float]:
    """Return by how much frames differ from those before them, while the VUT moves."""
    return {
        index: float(cv2.absdiff(small[index - 1], small[index]).mean())
        for index in sorted(small)
        if index - 1 in small and _moves(moments[index], vut_id)
    }


def _same(differences: Mapping[int, float]) -> set[int]:
    if not differences:
        return set()
    usual = float(np.percentile(list(differences.values()), 75))
    limit = min(_SAME_LEVELS, _SAME_SHARE * usual)
    return {index for index, one in differences.items() if one <= limit}
