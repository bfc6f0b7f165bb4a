"""Pictures of one recording that were encoded anew for another (METHOD 4.4).

Two cameras never see one picture, and neither does one camera on two drives. So fine detail is
correlated, of 2 to 10 of 128 columns, which brightness, size and compression leave as it is.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_eval.pictures.footage import Grey

Details = NDArray[np.float32]

_SIZE_PX = (128, 72)
_FINE, _COARSE = 0.6, 3.0
# In grey levels: a picture with less detail shows nothing that could be recognised.
_LEAST_DETAIL = 1.0
# Of the correlation with the picture before, from which on a picture is one of its own.
_OTHER = 0.97
# Of one recording, spread over the clip: 9 MB.
MOST_PICTURES = 250
# How these were chosen stands in docs/audit.md.
SAME = 0.95
LEAST_SAME, LEAST_SHARE = 10, 0.5


def details_of(pictures: Mapping[int, Grey]) -> Details:
    """Return the fine detail of each picture that has some, as rows of length 1, in order.

    Pictures that hardly differ from the one before are left out.
    """
    rows: list[NDArray[np.float32]] = []
    for index in sorted(pictures):
        small = cv2.resize(pictures[index], _SIZE_PX, interpolation=cv2.INTER_AREA)
        grey = small.astype(np.float32)
        fine = cv2.GaussianBlur(grey, (0, 0), _FINE) - cv2.GaussianBlur(grey, (0, 0), _COARSE)
        if float(fine.std()) < _LEAST_DETAIL:
            continue
        row = (fine - fine.mean()).ravel()
        row /= np.linalg.norm(row)
        if not rows or float(row @ rows[-1]) < _OTHER:
            rows.append(row)
    return np.array(rows, np.float32).reshape(len(rows), _SIZE_PX[0] * _SIZE_PX[1])


def mirrored(details: Details) -> Details:
    """Return the detail of the mirror images."""
    width, height = _SIZE_PX
    return details.reshape(-1, height, width)[:, :, ::-1].reshape(-1, width * height)


def same_pictures(first: Details, second: Details) -> int:
    """Count the pictures of the shorter recording that are in the other one, mirrored or not.

    Returns:
        0 where they are fewer than 10, or than half of the shorter recording's.
    """
    one, other = sorted((first, second), key=len)
    if len(one) < LEAST_SAME:
        return 0
    counts = [
        int(np.count_nonzero((one @ view.T).max(axis=1) >= SAME))
        for view in (other, mirrored(other))
    ]
    count = max(counts)
    return count if count >= max(LEAST_SAME, LEAST_SHARE * len(one)) else 0
