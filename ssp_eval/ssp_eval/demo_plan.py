"""The steps of ``ssp demo``: which commands it runs, what each needs, and where things lie."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ssp_core import __version__
from ssp_core.cli import LATE, VERBS
from ssp_core.hashing import sha256_json
from ssp_eval.data.provenance import labels_places
from ssp_eval.twins.files import twins_folder
from ssp_scenario_manager.event_spec.load import load_event

SCENARIOS = ("cut_in", "vru_crossing", "lead_braking", "occluded_crossing", "slow_lead")
DEFAULT_SCENARIOS = SCENARIOS[:2]
BRIDGES = ("constant_velocity", "opencv_baseline")
SIMULATION_SITE, TRACK_SITE = "boulevard", "north_track"
SIMULATION_SEED, TRACK_SEED = 11, 12
CLIP_SEED = 1
GENERATOR = "ssp-clip/1"
# Steps at a time, and processes of a step beside which no other has anything to do.
AT_ONCE = 2
_WORKERS = ("--workers", str(AT_ONCE))
TWINS = ("--change", "without=ot1", "--change", "control")


def _nothing() -> tuple[str, ...]:
    return ()


@dataclass(frozen=True, slots=True)
class Step:
    """One command of the demonstration.

    Args:
        arguments: of ``ssp``.
        needs: steps that must have been done.
        session: it runs a session; one at a time does.
        more: arguments that are known only when the steps before are done.
        after: steps that must have ended, be it without success.
        present: the arguments without what steps before it failed to make; None: all of them.
        makes: what is removed before it is done again.
    """

    name: str
    title: str
    arguments: tuple[str, ...]
    needs: tuple[str, ...] = ()
    session: bool = False
    more: Callable[[], tuple[str, ...]] = _nothing
    after: tuple[str, ...] = ()
    present: Callable[[], tuple[str, ...]] | None = None
    makes: tuple[Path, ...] = ()

    def command(self) -> list[str]:
        """Give the arguments of ``ssp``, once the steps that it needs are done."""
        arguments = self.arguments if self.present is None else self.present()
        return [*arguments, *self.more()]

    @property
    def modules(self) -> tuple[str, ...]:
        """The module whose ``main`` its process calls, and those that its verb needs."""
        verb = self.arguments[0]
        return "ssp_core.cli", VERBS[verb][0].partition(":")[0], *LATE.get(verb, ())

    @property
    def digest(self) -> str:
        """Hash of what it is asked to do."""
        return sha256_json([__version__, *self.arguments])


def run_folder(out: Path, scenario: str, domain: str) -> Path:
    """Return the folder of one recording: bag and labels.json, and more for a session."""
    return out / "runs" / f"{scenario}-{domain}"


def clip_path(out: Path, scenario: str) -> Path:
    return out / "clips" / f"{scenario}.mp4"


def event_path(out: Path, scenario: str) -> Path:
    """Return the K* that is bound to the clip, from which all three domains are made."""
    return clip_path(out, scenario).with_suffix(".event.yaml")


def _version(out: Path, scenario: str) -> tuple[str, str]:
    return "--event-version", load_event(str(event_path(out, scenario)))[1]


def audit_folder(out: Path, scenario: str) -> Path:
    return out / "audits" / scenario


def package_folder(out: Path) -> Path:
    return out / "package"


def declared_options(clip: Path) -> tuple[str, ...]:
    """Give what the maker of a clip declares of it, as options of ``ssp import-video``.

    The camera is known. The speed is the one at which the VUT drives at first, declared for all of
    the clip: it brakes later, and a video doesn't show by how much.
    """
    truth = json.loads(clip.with_suffix(".truth.json").read_text())
    camera = truth["camera"]
    return (
        *("--ego-speed", f"{truth['ego_speed_mps'][0]['speed_mps']:.2f}"),
        *("--hfov-deg", str(camera["hfov_deg"])),
        *("--camera-height", str(camera["height_m"])),
        *("--camera-pitch-deg", f"{math.degrees(camera['pitch_down_rad']):.3f}"),
    )


_DOMAINS = ("synthetic", "simulation", "physical")


def plan_steps(out: Path, scenarios: Sequence[str]) -> list[Step]:
    """Return all steps; each needs only ones before it."""
    of_each = [_of_scenario(out, scenario) for scenario in scenarios]
    # All clips first, then all simulations and so on: what takes longest begins early.
    return [
        *(step for steps in zip(*of_each, strict=True) for step in steps),
        *_evaluation(out, scenarios),
    ]


def _of_scenario(out: Path, scenario: str) -> list[Step]:
    """Return the clip, the recordings of the three domains, their labels and their audit."""
    clip, event = clip_path(out, scenario), str(event_path(out, scenario))
    task = str(out / "tasks" / f"{scenario}-track")
    synthetic, simulation, physical = (str(run_folder(out, scenario, d)) for d in _DOMAINS)
    recordings = (synthetic, simulation, physical)

    def step(
        name: str,
        title: str,
        *arguments: str,
        needs: tuple[str, ...] = (),
        session: bool = False,
        more: Callable[[], tuple[str, ...]] = _nothing,
        makes: tuple[str | Path, ...] = (),
    ) -> Step:
        before = tuple(f"{scenario}/{one}" for one in needs)
        return Step(
            f"{scenario}/{name}",
            f"{scenario}: {title}",
            arguments,
            before,
            session,
            more,
            makes=tuple(map(Path, makes)),
        )

    return [
        step(
            "clip",
            "make a synthetic clip and the K* bound to it",
            "spec",
            "clip",
            scenario,
            "--seed",
            str(CLIP_SEED),
            "--out",
            str(clip.parent),
            makes=(clip, Path(event), clip.with_suffix(".truth.json")),
        ),
        step(
            "simulation",
            "compile and run the simulation",
            "run",
            event,
            "--site",
            SIMULATION_SITE,
            "--seed",
            str(SIMULATION_SEED),
            "--out",
            simulation,
            needs=("clip",),
            session=True,
            makes=(simulation,),
        ),
        step(
            "synthetic",
            "import the clip as a bag",
            "import-video",
            str(clip),
            "--scenario",
            scenario,
            "--generator",
            GENERATOR,
            "--out",
            f"{synthetic}/bag",
            needs=("clip",),
            makes=(synthetic,),
            more=lambda: (*_version(out, scenario), *declared_options(clip)),
        ),
        step(
            "task",
            "compile for the track",
            "compile",
            event,
            "--target",
            "track",
            "--site",
            TRACK_SITE,
            "--seed",
            str(TRACK_SEED),
            "--validated-by",
            simulation,
            "--out",
            task,
            needs=("simulation",),
            makes=(task,),
        ),
        step(
            "physical",
            "run the compiled task on the track",
            "run",
            task,
            "--out",
            physical,
            needs=("task",),
            session=True,
            makes=(physical,),
        ),
        step(
            "twins",
            "make the simulation's twins: without its object, with an irrelevant one",
            "twins",
            simulation,
            *TWINS,
            needs=("simulation",),
            makes=(twins_folder(Path(simulation) / "bag"),),
        ),
        # One plan for the three recordings, so that each has as many labels in every phase.
        step(
            "labels",
            "label the three recordings by one plan",
            "labels",
            "new",
            *recordings,
            "--truth",
            str(clip.with_suffix(".truth.json")),
            needs=_DOMAINS,
            makes=tuple(labels_places(Path(one) / "bag")[2] for one in recordings),
        ),
        step(
            "audit",
            "audit the three recordings",
            "audit",
            *recordings,
            "--out",
            str(audit_folder(out, scenario)),
            needs=("labels",),
            makes=(audit_folder(out, scenario),),
        ),
    ]


def _evaluation(out: Path, scenarios: Sequence[str]) -> list[Step]:
    """Ask the bridges about every recording, score the answers, report and pack it all."""
    package = str(package_folder(out))
    return [
        Step(
            "evaluate",
            "ask the bridges and score",
            _evaluate_arguments(out, scenarios),
            after=tuple(
                f"{scenario}/{one}" for scenario in scenarios for one in ("audit", "twins")
            ),
            present=lambda: _evaluate_arguments(out, [s for s in scenarios if _is_audited(out, s)]),
        ),
        Step(
            "report",
            "write the report",
            # A scenario that failed before anything was asked about it is named in the report too.
            ("report", str(out), *(word for one in scenarios for word in ("--expect", one))),
            after=("evaluate",),
        ),
        Step(
            "package",
            "make the evidence package",
            ("package", "make", str(out), "--out", package, *_WORKERS),
            needs=("report",),
            makes=(Path(package),),
        ),
        Step(
            "verify",
            "verify the evidence package",
            ("package", "verify", package, *_WORKERS),
            needs=("package",),
        ),
    ]


def _evaluate_arguments(out: Path, scenarios: Sequence[str]) -> tuple[str, ...]:
    """Return arguments that ask the bridges about recordings and their twins."""
    bags = [str(run_folder(out, s, d) / "bag") for s in scenarios for d in _DOMAINS]
    audits = [word for s in scenarios for word in ("--audit", str(audit_folder(out, s)))]
    bridges = [word for name in BRIDGES for word in ("--bridge", name)]
    return ("evaluate", *bags, *audits, *bridges, "--twins", *_WORKERS, "--out", str(out))


def _is_audited(out: Path, scenario: str) -> bool:
    return (audit_folder(out, scenario) / "audit.json").is_file()
