"""What the camera's renderer ``gl`` needs of this machine: moderngl and EGL."""

from __future__ import annotations

import ctypes
import importlib.util

from ssp_core.errors import HostError

REMEDY = (
    "pip install 'ssp[gl]' and apt install libegl1 libgl1-mesa-dri; or take the renderer raster, "
    "which needs neither"
)
_LIBRARY = "libEGL.so.1"


def check_gl(library: str = _LIBRARY) -> None:
    """Looks for moderngl and EGL, without starting either.

    Raises:
        HostError: one of them is missing here; says how to get it.
    """
    if importlib.util.find_spec("moderngl") is None:
        raise HostError(f"renderer gl: moderngl isn't installed; {REMEDY}")
    try:
        ctypes.CDLL(library)
    except OSError as error:
        raise HostError(f"renderer gl: there is no EGL here ({error}); {REMEDY}") from error
