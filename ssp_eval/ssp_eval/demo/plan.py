"""What the demonstration does, as commands that a user could type, and which need which."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ssp_scenario_manager.event_spec.load import load_event

SCENARIOS = ("cut_in", "vru_crossing", "lead_braking", "occluded_crossing")
DEFAULT_SCENARIOS = SCENARIOS[:2]
BRIDGES = ("constant_velocity", "opencv_baseline")
SIMULATION_SITE, TRACK_SITE = "boulevard", "north_track"
SIMULATION_SEED, TRACK_SEED = 11, 12
CLIP_SEED = 1
GENERATOR = "ssp-clip/1"


def _nothing() -> tuple[str, ...]:
    return ()


@dataclass(frozen=True, slots=True)
class Step:
    """One command of the demonstration.

    Args:
        name: what others know it by.
        title: for the progress display.
        arguments: of ``ssp``.
        needs: names of the steps that must be done before.
        session: it runs a session; one at a time does.
        more: arguments that are known only when the steps before are done.
    """

    name: str
    title: str
    arguments: tuple[str, ...]
    needs: tuple[str, ...] = ()
    session: bool = False
    more: Callable[[], tuple[str, ...]] = _nothing

    def command(self, python: str) -> list[str]:
        """What to run, once the steps that it needs are done."""
        return [python, "-m", "ssp_core.cli", *self.arguments, *self.more()]


def run_folder(out: Path, scenario: str, domain: str) -> Path:
    """Folder of one recording: bag and labels.json, and more for a session."""
    return out / "runs" / f"{scenario}-{domain}"


def clip_path(out: Path, scenario: str) -> Path:
    return out / "clips" / f"{scenario}.mp4"


def event_path(out: Path, scenario: str) -> Path:
    """The K* that is bound to the clip, from which all three domains are made."""
    return clip_path(out, scenario).with_suffix(".event.yaml")


def _version(out: Path, scenario: str) -> tuple[str, str]:
    return "--event-version", load_event(str(event_path(out, scenario)))[1]


def audit_folder(out: Path, scenario: str) -> Path:
    return out / "audits" / scenario


def package_folder(out: Path) -> Path:
    return out / "package"


def declared_options(clip: Path) -> tuple[str, ...]:
    """What the maker of a clip declares of it, as options of ``ssp import-video``.

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


def steps(out: Path, scenarios: Sequence[str]) -> list[Step]:
    """All steps; each needs only ones before it.

    Args:
        out: folder of the demonstration.
        scenarios: names of shipped events.
    """
    plan = [_clip(out, scenario) for scenario in scenarios]
    plan += [step for scenario in scenarios for step in _simulation(out, scenario)]
    plan += [step for scenario in scenarios for step in _synthetic(out, scenario)]
    plan += [step for scenario in scenarios for step in _physical(out, scenario)]
    plan += [_labels(out, scenario) for scenario in scenarios]
    plan += [_audit(out, scenario) for scenario in scenarios]
    return [*plan, *_evaluation(out, scenarios)]


def _simulation(out: Path, scenario: str) -> list[Step]:
    folder = run_folder(out, scenario, "simulation")
    return [
        Step(
            f"{scenario}/simulation",
            f"{scenario}: compile and run the simulation",
            (
                *("run", str(event_path(out, scenario)), "--site", SIMULATION_SITE),
                *("--seed", str(SIMULATION_SEED), "--out", str(folder)),
            ),
            needs=(f"{scenario}/clip",),
            session=True,
        ),
    ]


def _clip(out: Path, scenario: str) -> Step:
    folder = clip_path(out, scenario).parent
    return Step(
        f"{scenario}/clip",
        f"{scenario}: make a synthetic clip and the K* bound to it",
        ("spec", "clip", scenario, "--seed", str(CLIP_SEED), "--out", str(folder)),
    )


def _synthetic(out: Path, scenario: str) -> list[Step]:
    clip = clip_path(out, scenario)
    folder = run_folder(out, scenario, "synthetic")
    return [
        Step(
            f"{scenario}/synthetic",
            f"{scenario}: import the clip as a bag",
            (
                *("import-video", str(clip), "--scenario", scenario),
                *("--generator", GENERATOR, "--out", str(folder / "bag")),
            ),
            needs=(f"{scenario}/clip",),
            more=lambda: (*_version(out, scenario), *declared_options(clip)),
        ),
    ]


def _physical(out: Path, scenario: str) -> list[Step]:
    task = out / "tasks" / f"{scenario}-track"
    folder = run_folder(out, scenario, "physical")
    simulation = run_folder(out, scenario, "simulation")
    return [
        Step(
            f"{scenario}/task",
            f"{scenario}: compile for the track",
            (
                *("compile", str(event_path(out, scenario)), "--target", "track"),
                *("--site", TRACK_SITE),
                *("--seed", str(TRACK_SEED), "--validated-by", str(simulation)),
                *("--out", str(task)),
            ),
            needs=(f"{scenario}/simulation",),
        ),
        Step(
            f"{scenario}/physical",
            f"{scenario}: run the compiled task on the track",
            ("run", str(task), "--out", str(folder)),
            needs=(f"{scenario}/task",),
            session=True,
        ),
    ]


_DOMAINS = ("synthetic", "simulation", "physical")


def _labels(out: Path, scenario: str) -> Step:
    """One plan for the three recordings, so that each has as many labels in every phase."""
    recordings = (str(run_folder(out, scenario, domain)) for domain in _DOMAINS)
    truth = clip_path(out, scenario).with_suffix(".truth.json")
    return Step(
        f"{scenario}/labels",
        f"{scenario}: label the three recordings by one plan",
        ("labels", "new", *recordings, "--truth", str(truth)),
        needs=tuple(f"{scenario}/{domain}" for domain in _DOMAINS),
    )


def _audit(out: Path, scenario: str) -> Step:
    recordings = (str(run_folder(out, scenario, domain)) for domain in _DOMAINS)
    return Step(
        f"{scenario}/audit",
        f"{scenario}: audit the three recordings",
        ("audit", *recordings, "--out", str(audit_folder(out, scenario))),
        needs=(f"{scenario}/labels",),
    )


def _evaluation(out: Path, scenarios: Sequence[str]) -> list[Step]:
    """Asks the bridges about every recording, scores the answers, reports and packs it all."""
    bags = [str(run_folder(out, s, d) / "bag") for s in scenarios for d in _DOMAINS]
    audits = [word for s in scenarios for word in ("--audit", str(audit_folder(out, s)))]
    bridges = [word for name in BRIDGES for word in ("--bridge", name)]
    package = str(package_folder(out))
    return [
        Step(
            "evaluate",
            "ask the bridges and score",
            ("evaluate", *bags, *audits, *bridges, "--out", str(out)),
            needs=tuple(f"{scenario}/audit" for scenario in scenarios),
        ),
        Step("report", "write the report", ("report", str(out)), needs=("evaluate",)),
        Step(
            "package",
            "make the evidence package",
            ("package", "make", str(out), "--out", package),
            needs=("report",),
        ),
        Step(
            "verify",
            "verify the evidence package",
            ("package", "verify", package),
            needs=("package",),
        ),
    ]
