"""What the demonstration does, as a list of commands that a user could type."""

from __future__ import annotations

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


def steps(out: Path, event_versions: dict[str, str]) -> list[Step]:
    """All commands in order.

    Args:
        out: folder of the demonstration.
        event_versions: version of each scenario, which the synthetic clips are declared to show.
    """
    plan: list[Step] = []
    for scenario in SCENARIOS:
        clip = out / "clips" / f"{scenario}.mp4"
        folder = out / "runs" / f"{scenario}-synthetic"
        plan += [
            Step(
                f"{scenario}: make a synthetic clip",
                ("--scenario", scenario, "--out", str(clip)),
                module="ssp_ot_controller.camera.clip",
            ),
            Step(
                f"{scenario}: import the clip as a bag",
                (
                    "import-video",
                    str(clip),
                    "--ego-unknown",
                    "--scenario",
                    scenario,
                    "--event-version",
                    event_versions[scenario],
                    "--generator",
                    GENERATOR,
                    "--out",
                    str(folder / "bag"),
                ),
            ),
            Step(
                f"{scenario}: label the clip",
                (
                    "labels",
                    "new",
                    "--truth",
                    str(clip.with_suffix(".truth.json")),
                    "--event-version",
                    event_versions[scenario],
                    "--out",
                    str(folder / "labels.json"),
                ),
            ),
        ]
        for domain, site, seed in SESSIONS:
            folder = out / "runs" / f"{scenario}-{domain}"
            plan += [
                Step(
                    f"{scenario}: run the {domain} session",
                    ("run", scenario, "--site", site, "--seed", str(seed), "--out", str(folder)),
                ),
                Step(
                    f"{scenario}: label the {domain} session",
                    ("labels", "new", str(folder / "bag"), "--out", str(folder / "labels.json")),
                ),
            ]
    bridges = [argument for name in BRIDGES for argument in ("--bridge", name)]
    bags = [str(folder / "bag") for folder in recordings(out)]
    plan += [
        Step("ask the bridges and score", ("evaluate", *bags, *bridges, "--out", str(out))),
        Step("write the report", ("report", str(out))),
    ]
    return plan
