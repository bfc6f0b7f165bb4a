"""The disturbances between an object and its true state, its manager and its body, in one place.

A ``Channel`` belongs to the object's process, or to ``sil_world`` for the VUT:
localisation, clock and links. An ``Actuator`` belongs to the simulated body. Both are counted in
steps of the run and seeded per run, object and purpose, and draw once a step whatever is active,
so that one disturbance more or less leaves the others as they are. A ``FaultSchedule`` says when
the faults of the run file begin and end, by session time.
"""

from __future__ import annotations

import math
import zlib
from collections import deque
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from ssp_core.cdr.references import Acknowledgement
from ssp_core.cdr.steps import Heartbeat
from ssp_core.clock import seconds_to_ns
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Fault, FaultKind, LinkDisturbance, RunSpec
from ssp_core.world.plant import FaultFact
from ssp_ot_controller.bodies.dynamics import Command

UNITS: dict[FaultKind, str] = {
    "link_delay": "s",
    "clock_step": "s",
    "position_jump": "m",
    "actuator_stuck": "m/s^2",
    "vut_stop": "m/s^2",
}


@dataclass(frozen=True, slots=True)
class FaultChange:
    """A fault begins or ends (FaultEvent.msg).

    Args:
        number: of the fault in the run file, from 0.
        target: object or node that it strikes.
        active: True: it begins.
        value: its size, NaN for a kind without one.
    """

    number: int
    kind: FaultKind
    target: str
    active: bool
    value: float
    unit: str

    def fact(self, source: str, now_ns: int) -> FaultFact:
        """Make the fact that the node of that name reports."""
        name = f"{self.number} {self.kind}"
        return FaultFact(source, name, self.target, self.active, self.value, self.unit, now_ns)


class FaultSchedule:
    """The faults of one or a few targets, and which of them are active. Reads no clock.

    Args:
        faults: all faults of the run; their place is their number.
    """

    def __init__(
        self, faults: Sequence[Fault], targets: Collection[str], kinds: Collection[FaultKind]
    ) -> None:
        self._mine = [
            (i, f) for i, f in enumerate(faults) if f.target in targets and f.kind in kinds
        ]
        self._active: dict[int, Fault] = {}
        self._begun = False

    @property
    def is_empty(self) -> bool:
        return not self._mine

    def begin(self, now_ns: int, *, running: bool, armed: bool) -> list[FaultChange]:
        """Begin and end what is due, once a step before anything else of it; return the changes.

        Args:
            now_ns: session time of the step.
            running: the session's time goes; False while the world holds.
            armed: the target is armed. A fault without a time begins then.
        """
        if not self._mine:
            return []
        self._begun = self._begun or running
        changes = []
        for number, fault in self._mine:
            is_due = self._is_due(fault, now_ns, armed)
            if is_due == (number in self._active):
                continue
            if is_due:
                self._active[number] = fault
            else:
                del self._active[number]
            changes.append(
                FaultChange(
                    number,
                    fault.kind,
                    fault.target,
                    is_due,
                    math.nan if fault.value is None else fault.value,
                    UNITS.get(fault.kind, ""),
                )
            )
        return changes

    def active(self, kind: FaultKind) -> list[Fault]:
        """Return the active faults of a kind, in the order of the run file."""
        if not self._active:
            return []
        return [self._active[i] for i in sorted(self._active) if self._active[i].kind == kind]

    def has(self, kind: FaultKind) -> bool:
        return bool(self._active) and any(f.kind == kind for f in self._active.values())

    def total(self, kind: FaultKind) -> float:
        """Return the sum of the values of the active faults of a kind."""
        return sum(f.value or 0.0 for f in self.active(kind))

    def share(self, kind: FaultKind, usual: float) -> float:
        """Return the probability that the usual or one of the active faults of a kind strikes."""
        pass_probability = 1.0 - usual
        for fault in self.active(kind):
            pass_probability *= 1.0 - (fault.value or 0.0)
        return usual if pass_probability == 1.0 - usual else 1.0 - pass_probability

    def _is_due(self, fault: Fault, now_ns: int, armed: bool) -> bool:
        if not self._begun:
            # Before the start time stands still; a duration counts from the start.
            return fault.at_s is None and armed
        start_ns = seconds_to_ns(fault.at_s or 0.0)
        if fault.duration_s is not None and now_ns >= start_ns + seconds_to_ns(fault.duration_s):
            return False
        return now_ns >= start_ns


_BLOCK = 256


def _generator(seed: int, name: str, purpose: str) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(f"{name}/{purpose}".encode())])


def uniforms(seed: int, name: str, purpose: str) -> Iterator[float]:
    """Yield numbers in [0, 1), the same for the same seed, name and purpose."""
    random = _generator(seed, name, purpose)
    while True:
        yield from random.random(_BLOCK).tolist()


def normals(seed: int, name: str, purpose: str) -> Iterator[float]:
    """Yield standard normal numbers, the same for the same seed, name and purpose."""
    random = _generator(seed, name, purpose)
    while True:
        yield from random.standard_normal(_BLOCK).tolist()


Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class LinkQuality:
    """The quality of a link.

    Args:
        delay_s: each message arrives that much later, to the nearest step.
        jitter_s: one sigma that is added to the delay; messages keep their order.
        loss: share of the steps whose messages are lost.
        reorder: share of the steps whose messages are overtaken by the next ones.
    """

    delay_s: float = 0.0
    jitter_s: float = 0.0
    loss: float = 0.0
    reorder: float = 0.0


class Link(Generic[Item]):
    """Messages of one kind on their way. What is sent in one step shares its fate.

    Args:
        run: gives seed and step.
        object_id: whose.
        purpose: of its random numbers, of which one of each kind is drawn a step.
        quality: by the run file.
        faults: those that the object's links may have.
    """

    def __init__(
        self,
        run: RunSpec,
        object_id: str,
        purpose: str,
        quality: LinkQuality,
        faults: FaultSchedule,
    ) -> None:
        self._step_ns = seconds_to_ns(run.step_s)
        self._quality, self._faults = quality, faults
        self._plain = faults.is_empty and quality == LinkQuality()
        self._losses = uniforms(run.seed, object_id, purpose)
        self._jitters = normals(run.seed, object_id, f"{purpose} jitter")
        self._overtakings = uniforms(run.seed, object_id, f"{purpose} order")
        self.clear()

    def clear(self) -> None:
        """Drop everything that is under way."""
        self._under_way: deque[tuple[int, Sequence[Item]]] = deque()
        self._overtaken: Sequence[Item] = ()
        self._last_due_ns = 0

    def pass_on(
        self, items: Sequence[Item], now_ns: int, draws: Iterator[float] | None
    ) -> list[Item]:
        """Take in what is sent in this step; return what arrives, in order of arrival.

        Args:
            items: that are sent.
            now_ns: session time.
            draws: numbers in [0, 1) of a world that holds, where time stands still: what is sent
                arrives, unless a fault keeps it from it; None: the world runs.
        """
        if self._plain:
            return list(items)
        quality, faults = self._quality, self._faults
        cut = faults.has("link_cut")
        if draws is not None:
            lost = cut or next(draws) < faults.share("link_loss", 0.0)
            return [] if lost else list(items)
        lost = next(self._losses) < faults.share("link_loss", quality.loss)
        jitter = next(self._jitters)
        overtaken = next(self._overtakings) < faults.share("link_reorder", quality.reorder)
        if cut:
            self.clear()
            return []
        if items and not lost:
            delay_s = quality.delay_s + faults.total("link_delay")
            late_s = max(delay_s + quality.jitter_s * jitter, 0.0)
            late_steps = round(late_s * 1e9 / self._step_ns)
            due_ns = max(now_ns + late_steps * self._step_ns, self._last_due_ns)
            self._last_due_ns = due_ns
            if overtaken and not self._overtaken:
                self._overtaken = items
            else:
                self._under_way.append((due_ns, items))
                if self._overtaken:
                    self._under_way.append((due_ns, self._overtaken))
                    self._overtaken = ()
        arrived: list[Item] = []
        while self._under_way and self._under_way[0][0] <= now_ns:
            arrived += self._under_way.popleft()[1]
        return arrived


# Below this speed an object stands, and its wheel sensors say so.
_WHEELS_TURN_MPS = 0.1
LINK_FAULTS: tuple[FaultKind, ...] = ("link_cut", "link_delay", "link_loss", "link_reorder")
OWN_FAULTS: tuple[FaultKind, ...] = ("clock_step", "position_jump", "state_nan", "state_frozen")
ACTUATOR_FAULTS: tuple[FaultKind, ...] = ("actuator_stuck",)


@dataclass(frozen=True, slots=True)
class LinkSizes:
    """The true one-way delays and clock offset that a measurement would find, s.

    Args:
        clock_offset_s: the object's clock minus the manager's.
        up_s: from the object to the manager, jitter left out.
        down_s: from the manager to the object.
        cut: nothing passes.
    """

    clock_offset_s: float
    up_s: float
    down_s: float
    cut: bool


class Localisation:
    """The localisation of one object: its noise, its dropouts, and the faults of its places.

    It draws the same numbers in each step, whatever the disturbance is.
    """

    def __init__(self, run: RunSpec, object_id: str, faults: FaultSchedule) -> None:
        self._noise: LinkDisturbance = run.disturbance_of(object_id)
        self._step_s = run.step_s
        self._faults = faults
        self._position = normals(run.seed, object_id, "localisation")
        self._dropouts = uniforms(run.seed, object_id, "dropout")
        self._dropout_ends_ns: int | None = None
        self._fix: ObjectState | None = None
        self._frozen: ObjectState | None = None

    def locate(self, truth: ObjectState, now_ns: int) -> ObjectState:
        """Return the fix of a step: with noise, or in a dropout the last one again."""
        n = self._noise
        dx, dy, dv = next(self._position), next(self._position), next(self._position)
        begins = next(self._dropouts) < n.dropout_per_s * self._step_s
        if self._dropout_ends_ns is not None and now_ns >= self._dropout_ends_ns:
            self._dropout_ends_ns = None
        if begins and self._dropout_ends_ns is None:
            self._dropout_ends_ns = now_ns + seconds_to_ns(n.dropout_s)
        if self._dropout_ends_ns is not None and self._fix is not None:
            return replace(self._fix, sequence=truth.sequence)
        self._fix = truth
        if n.position_noise_m or n.speed_noise_mps:
            moves = truth.speed_mps > _WHEELS_TURN_MPS
            self._fix = replace(
                truth,
                x_m=truth.x_m + n.position_noise_m * dx,
                y_m=truth.y_m + n.position_noise_m * dy,
                speed_mps=truth.speed_mps + (n.speed_noise_mps * dv if moves else 0.0),
                position_std_m=n.position_noise_m,
            )
        return self._fix

    def spoil(self, fix: ObjectState) -> ObjectState:
        """Return a fix as the faults that are active make it."""
        jump_m = self._faults.total("position_jump")
        if jump_m:
            x, y = fix.pose.to_parent(0.0, jump_m)
            fix = replace(fix, x_m=x, y_m=y)
        if not self._faults.has("state_frozen"):
            self._frozen = None
        elif self._frozen is None:
            self._frozen = fix
        else:
            fix = replace(self._frozen, stamp_ns=fix.stamp_ns, sequence=fix.sequence)
        if self._faults.has("state_nan"):
            fix = replace(fix, x_m=math.nan, y_m=math.nan)
        return fix


class Channel:
    """Localisation, clock and links of one object. Reads no clock.

    ``begin`` opens each step; the others then take that step's states and messages. While the world
    holds, noise, delays and losses of the run file are off (the links are judged by what is
    measured of them before the start), but faults without a time strike as soon as the object is
    armed.
    """

    def __init__(self, run: RunSpec, object_id: str) -> None:
        self._noise: LinkDisturbance = run.disturbance_of(object_id)
        kinds = (*LINK_FAULTS, *OWN_FAULTS, *ACTUATOR_FAULTS)
        self._faults = FaultSchedule(run.faults, (object_id,), kinds)
        self._running = False
        self._localisation = Localisation(run, object_id, self._faults)
        # How often the world holds isn't the same in two runs: no draws of the run's own streams.
        self._hold = uniforms(run.seed, object_id, "hold")
        self._active_hold: Iterator[float] | None = self._hold
        n, faults = self._noise, self._faults
        up = LinkQuality(n.state_delay_s, n.state_jitter_s, n.state_loss, n.reorder)
        # The transport of acknowledgements is reliable: only a fault loses them.
        acks = LinkQuality(n.state_delay_s, n.state_jitter_s)
        down = LinkQuality(n.command_delay_s, 0.0, n.command_loss)
        self._up: Link[ObjectState] = Link(run, object_id, "link", up, faults)
        self._acks: Link[Acknowledgement] = Link(run, object_id, "acks", acks, faults)
        self._heartbeats: Link[Heartbeat] = Link(run, object_id, "heartbeats", down, faults)
        self._references: Link[Reference] = Link(run, object_id, "references", down, faults)
        self._offset_ns = seconds_to_ns(n.clock_offset_s)
        self._plain_own = faults.is_empty and not any(
            (n.position_noise_m, n.speed_noise_mps, n.dropout_per_s, n.clock_offset_s)
        )

    def begin(self, now_ns: int, *, running: bool, armed: bool) -> list[FaultChange]:
        """Open a step; return what begins or ends with it, to be published as FaultEvent.

        Args:
            now_ns: session time of the step.
            running: the session's time goes; False while the world holds.
            armed: the object is armed.
        """
        if running and not self._running:
            for line in (self._up, self._acks, self._heartbeats, self._references):
                line.clear()
        self._running = running
        self._active_hold = None if running else self._hold
        return self._faults.begin(now_ns, running=running, armed=armed)

    def clock_ns(self, now_ns: int) -> int:
        """Return the object's own clock at a session time: its states and acks carry it."""
        offset_ns = self._offset_ns if self._running else 0
        if self._faults.is_empty:
            return now_ns + offset_ns
        return now_ns + seconds_to_ns(self._faults.total("clock_step")) + offset_ns

    def links(self) -> LinkSizes:
        """Return clock and delays as they are now, for measuring the link outside the steps."""
        n, extra_s = self._noise, self._faults.total("link_delay")
        return LinkSizes(
            n.clock_offset_s + self._faults.total("clock_step"),
            n.state_delay_s + extra_s,
            n.command_delay_s + extra_s,
            self._faults.has("link_cut"),
        )

    # -- localisation --------------------------------------------------------------------------

    def measure(self, truth: ObjectState, now_ns: int) -> ObjectState:
        """Compute the state that the object's localisation makes of its true state.

        Noise, then dropout (the last state again, with its old stamp), jump to the left, frozen
        position, not a number, and the object's own clock on the stamp.
        """
        if self._plain_own:
            return truth
        fix = self._localisation.locate(truth, now_ns) if self._running else truth
        return self._stamped(fix if self._faults.is_empty else self._localisation.spoil(fix))

    def _stamped(self, fix: ObjectState) -> ObjectState:
        offset_ns = self.clock_ns(0)
        return replace(fix, stamp_ns=fix.stamp_ns + offset_ns) if offset_ns else fix

    # -- links ---------------------------------------------------------------------------------

    def up(self, state: ObjectState, now_ns: int) -> list[ObjectState]:
        """Send a state to the manager; return the states that arrive there now, in that order."""
        return self._up.pass_on([state], now_ns, self._active_hold)

    def up_acks(self, acks: Sequence[Acknowledgement], now_ns: int) -> list[Acknowledgement]:
        """Send acknowledgements to the manager; return those that arrive there now."""
        return self._acks.pass_on(acks, now_ns, self._active_hold)

    def down_heartbeats(self, beats: Sequence[Heartbeat], now_ns: int) -> list[Heartbeat]:
        """Send heartbeats; return those that reach the object now, earlier ones too."""
        return self._heartbeats.pass_on(beats, now_ns, self._active_hold)

    def down_references(self, references: Sequence[Reference], now_ns: int) -> list[Reference]:
        """Send references; return those that reach the object now, earlier ones too."""
        return self._references.pass_on(references, now_ns, self._active_hold)


class Actuator:
    """Drive and brakes of one simulated body, healthy or not."""

    def __init__(self, run: RunSpec, object_id: str) -> None:
        self._faults = FaultSchedule(run.faults, (object_id,), ACTUATOR_FAULTS)
        self._last: Command | None = None

    def actuate(self, command: Command, now_ns: int) -> Command:
        """Compute the body's response to a command.

        A stuck actuator keeps the fault's acceleration, or without one the last command's; steering
        still works, and so does an emergency stop, which has a brake of its own.
        """
        if self._faults.is_empty:
            return command
        self._faults.begin(now_ns, running=True, armed=True)
        stuck = self._faults.active("actuator_stuck")
        if not stuck:
            self._last = command
            return command
        if command.emergency_stop:
            return command
        last_mps2 = self._last.acceleration_mps2 if self._last is not None else 0.0
        value = stuck[-1].value
        return replace(command, acceleration_mps2=last_mps2 if value is None else value)
