"""OpenGL without a window, in a thread of its own: a context belongs to the thread that made it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any, TypeVar

from ssp_core.errors import HostError
from ssp_core.offscreen import REMEDY, check_gl

T = TypeVar("T")

_NEEDED = 330


def _make() -> Any:
    check_gl()
    import moderngl

    create: Any = moderngl.create_context  # its types don't know of backends
    try:
        return create(standalone=True, backend="egl", require=_NEEDED)
    except Exception as error:  # moderngl raises bare Exceptions and ImportErrors of libraries
        raise HostError(
            f"renderer gl: no OpenGL 3.3 through EGL here ({error}); {REMEDY}"
        ) from error


class GlThread:
    """Runs functions one after the other in the thread that holds the context."""

    def __init__(self, make: Callable[[], Any] = _make) -> None:
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="gl")
        try:
            self.context = self._worker.submit(make).result()
        except BaseException:
            self._worker.shutdown()
            raise

    def call(self, function: Callable[..., T], *args: Any) -> T:
        """The function's result, or its exception."""
        return self._worker.submit(function, *args).result()

    @property
    def device(self) -> str:
        """What draws, in the driver's words."""
        return str(self.context.info["GL_RENDERER"])


@lru_cache(maxsize=1)
def gl_thread() -> GlThread:
    """The process's context, made on the first call.

    Raises:
        HostError: moderngl or EGL is missing here.
    """
    return GlThread()
