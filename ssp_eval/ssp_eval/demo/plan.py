"""What the demonstration does, as a list of commands that a user could type."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

SCENARIOS = ("cut_in", "vru_crossing")
# Domain, site and seed of the recorded sessions.
SESSIONS = (("simulation", "boulevard", 11), ("physical", "north_track", 12))
BRIDGES = ("constant_velocity", "opencv_baseline")
GENERATOR = "ssp clip maker (rendered, kinematic)"


@dataclass(frozen=True, slots=True)
class Step:
    """One command of the demonstration.

    Args:
        title: for the progress display.
        arguments: of ``ssp``; of ``python -m`` when ``module`` is set.
        module: a Python module to run instead of an ssp verb.
    """

    title: str
    arguments: tuple[str, ...]
    module: str | None = None

    def command(self, python: str) -> list[str]:
        if self.module is not None:
            return [python, "-m", self.module, *self.arguments]
        return [python, "-m", "ssp_core.cli", *self.arguments]


def recordings(out: Path) -> list[Path]:
    """Folders that hold one recording (bag and labels.json) each."""
    folders = []
    for scenario in SCENARIOS:
        folders.append(out / "runs" / f"{scenario}-synthetic")
        folders += [out / "runs" / f"{scenario}-{domain}" for domain, _, _ in SESSIONS]
    return folders


def clip_path(out: Path, scenario: str) -> Path:
    return out / "clips" / f"{scenario}.mp4"


def clip_steps(out: Path) -> list[Step]:
    """Makes the synthetic clips, each with its truth file."""
    return [
        Step(
            f"{scenario}: make a synthetic clip",
            ("--scenario", scenario, "--out", str(clip_path(out, scenario))),
            module="ssp_ot_controller.camera.clip",
        )
        for scenario in SCENARIOS
    ]


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


def recording_steps(
    out: Path, event_versions: dict[str, str], declared: dict[str, tuple[str, ...]]
) -> list[Step]:
    """Imports and labels the clips, runs and labels the sessions.

    Args:
        out: folder of the demonstration.
        event_versions: version of each scenario, which the synthetic clips are declared to show.
        declared: options that declare speed and camera of each scenario's clip.
    """
    plan: list[Step] = []
    for scenario in SCENARIOS:
        clip = clip_path(out, scenario)
        folder = out / "runs" / f"{scenario}-synthetic"
        version = ("--event-version", event_versions[scenario])
        bag, labels = str(folder / "bag"), str(folder / "labels.json")
        truth = str(clip.with_suffix(".truth.json"))
        plan += [
            Step(
                f"{scenario}: import the clip as a bag",
                (
                    *("import-video", str(clip), *declared[scenario], "--scenario", scenario),
                    *(*version, "--generator", GENERATOR, "--out", bag),
                ),
            ),
            Step(
                f"{scenario}: label the clip",
                ("labels", "new", "--truth", truth, *version, "--out", labels),
            ),
        ]
        for domain, site, seed in SESSIONS:
            folder = out / "runs" / f"{scenario}-{domain}"
            bag, labels = str(folder / "bag"), str(folder / "labels.json")
            plan += [
                Step(
                    f"{scenario}: run the {domain} session",
                    ("run", scenario, "--site", site, "--seed", str(seed), "--out", str(folder)),
                ),
                Step(
                    f"{scenario}: label the {domain} session",
                    ("labels", "new", bag, "--out", labels),
                ),
            ]
    return plan


def scoring_steps(out: Path) -> list[Step]:
    """Asks the bridges about every recording, scores the answers, writes the report."""
    bridges = [argument for name in BRIDGES for argument in ("--bridge", name)]
    bags = [str(folder / "bag") for folder in recordings(out)]
    return [
        Step("ask the bridges and score", ("evaluate", *bags, *bridges, "--out", str(out))),
        Step("write the report", ("report", str(out))),
    ]
