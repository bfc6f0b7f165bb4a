"""The frames for a seeing driver's questions: each drawn once, on demand."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import PeerError
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import SeenFrame

if TYPE_CHECKING:
    from ssp_ot_controller.camera.renderer.scene import Scene

# A VUT that moved so far between two frames has left no pixel as it was.
_MOVED_M = 0.05
_SLACK_NS = 1_000_000


@dataclass(slots=True)
class _FrameRecord:
    step: int
    stamp_ns: int
    scene: Scene
    frame: SeenFrame | None = None


class QuestionFrames:
    """The camera of a driver: it keeps the scenes that a question may show, and draws few of them.

    A scene is drawn for the first question that shows it, with the pixels and the JPEG that the
    recorder of the session has.

    Args:
        run: with a camera.
        span_s: greatest age of a frame in a question.
    """

    def __init__(self, run: RunSpec, span_s: float) -> None:
        # The renderer's kernels take a second to load.
        from ssp_ot_controller.camera.redraw import Redrawing

        self._drawing = Redrawing(run)
        self._span_ns = seconds_to_ns(span_s) + _SLACK_NS
        self._scenes: deque[_FrameRecord] = deque()
        self._step = -1

    def see(self, step: int, stamp_ns: int, truths: Sequence[ObjectState]) -> None:
        """Take the states of a step; one that is repeated counts once."""
        if step == self._step:
            return
        self._step = step
        scene = self._drawing.see(step, stamp_ns, truths)
        if scene is None:
            return
        self._scenes.append(_FrameRecord(step, stamp_ns, scene))
        while self._scenes[0].stamp_ns < stamp_ns - self._span_ns:
            self._scenes.popleft()

    @property
    def stamps_ns(self) -> list[int]:
        """Stamps of the frames that a question about the newest one may show, rising."""
        return [one.stamp_ns for one in self._scenes]

    def show(self, indices: Sequence[int]) -> tuple[SeenFrame, ...]:
        """Return frames by their index in ``stamps_ns``."""
        return tuple(self._frame_of(self._scenes[i]) for i in indices)

    def _frame_of(self, record: _FrameRecord) -> SeenFrame:
        if record.frame is None:
            jpeg = self._drawing.draw(record.scene, record.step, record.stamp_ns).jpeg
            record.frame = SeenFrame(record.stamp_ns, jpeg)
        return record.frame


class FreshFrames:
    """The check that a question shows what the world is: new pixels, of its own stamp (METHOD 8.2).

    The camera's fault ends the run as one of the harness, and is never the driver's.
    """

    def __init__(self) -> None:
        self._places: dict[int, tuple[float, float]] = {}
        self._newest: SeenFrame | None = None

    def check(
        self, frames: Sequence[SeenFrame], stamp_ns: int, states: Sequence[ObjectState]
    ) -> None:
        """Refuse frames that are not of now.

        Args:
            frames: of the question, oldest first.
            stamp_ns: of the question.
            states: of the VUT, as far back as frames may be.

        Raises:
            PeerError: a frame has another stamp than it must have, or the pixels of an earlier one.
        """
        stamps = [frame.stamp_ns for frame in frames]
        if not stamps or stamps[-1] != stamp_ns or sorted(set(stamps)) != stamps:
            times_text = ", ".join(f"{ns_to_seconds(one):.3f}" for one in stamps) or "none"
            raise PeerError(
                f"the frames of {times_text} s are not those of a question about "
                f"{ns_to_seconds(stamp_ns):.3f} s"
            )
        at = {state.stamp_ns: (state.x_m, state.y_m) for state in states}
        before = [self._newest] if self._newest is not None else []
        for old in (*before, *frames):
            for new in frames:
                self._compare(old, new, at)
        self._newest = frames[-1]
        self._places = {stamp_ns: at[stamp_ns]} if stamp_ns in at else {}

    def _compare(self, old: SeenFrame, new: SeenFrame, at: dict[int, tuple[float, float]]) -> None:
        if old.stamp_ns >= new.stamp_ns or old.jpeg != new.jpeg:
            return
        was, now = self._places.get(old.stamp_ns, at.get(old.stamp_ns)), at.get(new.stamp_ns)
        if was is None or now is None:
            return
        way_m = ((now[0] - was[0]) ** 2 + (now[1] - was[1]) ** 2) ** 0.5
        if way_m > _MOVED_M:
            raise PeerError(
                f"the frame of {ns_to_seconds(new.stamp_ns):.3f} s has the pixels of that of "
                f"{ns_to_seconds(old.stamp_ns):.3f} s, and the VUT moved by {way_m:.2f} m between"
            )
