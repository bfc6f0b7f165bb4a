"""The camera's newest picture on its way to the page; only one that can be shown counts."""

from __future__ import annotations

from ssp_monitor.watch.board import Board
from ssp_monitor.watch.conversions import jpeg_of

NOT_JPEG = "not JPEG"


class Pictures:
    """Takes messages as they come, gives pictures at a bounded rate.

    Args:
        board: is told when the newest picture came, and what is wrong with the camera.
        period_ns: between two pictures, at the least.
    """

    def __init__(self, board: Board, period_ns: int) -> None:
        self._board = board
        self._period_ns = period_ns
        self._newest: tuple[bytes, int] | None = None
        self._jpeg: bytes | None = None
        self._next_ns = 0

    def put(self, data: bytes, at_ns: int) -> None:
        """A serialised CompressedImage, with its time of arrival on the steady clock."""
        self._newest = (data, at_ns)

    def settle(self) -> str:
        """Looks at what came last; what is wrong with it, empty when nothing is."""
        if self._newest is None:
            return ""
        (data, at_ns), self._newest = self._newest, None
        try:
            self._jpeg = bytes(jpeg_of(data))
        except ValueError as error:
            self._board.camera_fault = NOT_JPEG
            return str(error)
        self._board.camera_at_ns, self._board.camera_fault = at_ns, ""
        return ""

    def take(self, now_ns: int) -> bytes | None:
        """The newest picture, if one is due that nobody took yet.

        Args:
            now_ns: steady clock.
        """
        if self._jpeg is None or now_ns < self._next_ns:
            return None
        self._next_ns = now_ns + self._period_ns
        jpeg, self._jpeg = self._jpeg, None
        return jpeg
