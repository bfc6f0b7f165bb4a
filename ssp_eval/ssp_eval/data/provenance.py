"""The bag's own statements, of a run or an import, and the places of files that belong to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, TypeVar

from pydantic import ConfigDict, Field, model_validator

from ssp_core.bag.reading.reader import BagReader, content_sha256
from ssp_core.bag.seals.declaration import DECLARATION_FILE, check_result, participation_of
from ssp_core.bag.seals.seal import REPORT_NAME, check_unaltered, read_seal
from ssp_core.bag.seals.verdict import check_verdict
from ssp_core.carla.record import CarlaPlantRecord, CarlaScene
from ssp_core.cdr.messages import stamp_ns
from ssp_core.errors import InputError
from ssp_core.files.reading import parse_mapping, parse_model
from ssp_core.hashing import sha256_file
from ssp_core.names import CAMERA_RENDERER, SESSION_STATE, WORLD_PLANT, absolute
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participation import CAMERA, Participation, Standing, stands_in
from ssp_core.run_file.road import Road
from ssp_core.run_file.values import NonNegative, ObjectId, Strict
from ssp_core.run_file.verdict import VERDICT_FILE, RecordedVerdict, read_verdict
from ssp_core.vocabulary import DomainWord, ObjectWord, SessionPhase, Verdict
from ssp_eval.data.drawn import Redrawing, read_redrawing
from ssp_eval.data.server import ServerProbe, read_probe, read_server

SCHEMA: Literal["ssp.import/2"] = "ssp.import/2"
IMPORT_ATTACHMENT = "import.json"
TWIN_ATTACHMENT = "twin.json"
# A domain is a part of a cell's folder name, and so is a scenario.
SAFE_NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"

Words = Annotated[str, Field(min_length=1, max_length=500, pattern=r"\S")]


class ImportedEgo(Strict):
    """The VUT's motion, and how it is known."""

    provenance: Literal["measured", "declared", "unknown"]
    speed_mps: NonNegative | None = Field(description="constant; null: measured or unknown")


class ImportedCamera(Strict):
    """Geometry of the camera, and how that is known."""

    provenance: Literal["measured", "declared", "assumed", "unknown"]
    hfov_deg: float | None
    height_m: float | None
    pitch_down_rad: float | None


class DomainDeclaration(Strict):
    """A person's declaration of a recording's domain, with its date and place (METHOD 4.4)."""

    by: Words
    on: date = Field(description="when the recording was made")
    place: Words

    @property
    def text(self) -> str:
        return f"declared by {self.by}, {self.on.isoformat()}, {self.place}"


class LogDeclaration(Strict):
    """A named person's declaration of what a recording without our log can't show (METHOD 4.3)."""

    by: Words
    on: date
    safety_abort: bool = Field(description="true: there was one")
    identity_switch: bool = Field(description="true: there was one")
    site_changes: list[Words] = Field(description="what was changed on site; empty: nothing")


class ImportedStates(Strict):
    """The origin of the states on the objects' topics.

    The states themselves stand on ``<object>/state`` in the bag, frame map, on the recording's
    clock; everything that measures an event reads them there.
    """

    name: Words = Field(description="of the file, or of the bag")
    sha256: str = Field(pattern=r"^sha256:[0-9a-f]{64}$")
    vut: ObjectId
    objects: Annotated[dict[ObjectId, ObjectWord], Field(min_length=1, max_length=64)] = Field(
        description="class of every object target"
    )
    time_offset_s: Annotated[float, Field(ge=-1e10, le=1e10)] = Field(
        0.0, description="added to the source's times, which may count from 1970"
    )
    notes: list[Words] = Field([], description="gaps, what was derived, frames and time bases")


class ImportedSite(Strict):
    """The road that is bound to a recording: topology comes from it (METHOD 4.3).

    The file itself is an attachment of the bag, whose bytes have this hash.
    """

    name: Words
    kind: Literal["site", "opendrive", "sumo"]
    attachment: Words
    sha256: str = Field(pattern=r"^sha256:[0-9a-f]{64}$")
    block: Words = Field(description="the stretch of road that the VUT drives on")
    road: Road
    road_type: Literal["urban", "rural", "motorway", "proving_ground", "unresolved"]
    left_boundary: Literal["kerb", "sidewalk", "shoulder", "verge", "unresolved"]
    right_boundary: Literal["kerb", "sidewalk", "shoulder", "verge", "unresolved"]


class AcceptedFinding(Strict):
    """A finding of an import that a person took as it is (``--accept``)."""

    name: Words
    text: Words = Field(description="where, what and how much of it")


class ImportRecord(Strict):
    """``import.json``."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_: Literal["ssp.import/1", "ssp.import/2"] = Field(SCHEMA, alias="schema")
    source: dict[str, object] = Field(description="name, sha256, kind; of a video its format")
    crop: dict[str, object] = Field(description="start_s and end_s on the source's clock")
    generator: str
    domain: DomainWord
    scenario: Annotated[str, Field(pattern=SAFE_NAME)] | None
    event_version: str | None
    ego: ImportedEgo
    camera: ImportedCamera
    declaration: DomainDeclaration | None = None
    log: LogDeclaration | None = None
    states: ImportedStates | None = None
    site: ImportedSite | None = None
    accepted: list[AcceptedFinding] = []
    rules_version: int = Field(1, description="by which it was checked; 1: none was named")
    notes: list[Words] = Field([], description="on file and frames, beside those on the states")

    @model_validator(mode="after")
    def _objects_are_apart(self) -> ImportRecord:
        if self.states is not None and self.states.vut in self.states.objects:
            raise ValueError(f"states: {self.states.vut} is the VUT and an object target")
        return self

    @property
    def source_name(self) -> str:
        return str(self.source.get("name"))

    @property
    def accepted_names(self) -> list[str]:
        """Names of what was accepted as it is, each once."""
        return list(dict.fromkeys(one.name for one in self.accepted))

    @property
    def accepted_text(self) -> str:
        """Describe for people the findings that were accepted; empty: none."""
        return "; ".join(f"{one.name}: {one.text}" for one in self.accepted)

    @property
    def source_sha256(self) -> str | None:
        """Hash of the file that was imported."""
        digest = self.source.get("sha256")
        return digest if isinstance(digest, str) else None


OUR_RENDERER = "the camera of ssp"
CARLA = "CARLA"
COUNTERPART = "a stand-in for CARLA in tests"
# Generators of clips that the same camera draws, see ssp_ot_controller.camera.clip.
_OUR_CLIPS = "ssp-clip/"
RUN_ATTACHMENT = "run.yaml"
NO_VERDICT = f"the bag holds no {VERDICT_FILE}: the runner's word on how the run ended is missing"


@dataclass(frozen=True)
class Participants:
    """The participants of a recording's event, by the ids of their states.

    Args:
        targets: class word of every object target, by id.
    """

    vut: str
    targets: Mapping[str, str]
    traffic: tuple[str, ...] = ()

    @property
    def ids(self) -> tuple[str, ...]:
        """The VUT first, then the object targets."""
        return (self.vut, *self.targets)


@dataclass(frozen=True)
class Provenance:
    """The origin of a clip.

    Args:
        bag_sha256: content hash of its MCAP file or files.
        scenario: None where an imported video doesn't say.
        domain: of METHOD 5.2.
        domain_said_by: who says so, for people: the session's mode, or a named person.
        event_version: K* version, None where an imported video doesn't say.
        ego: measured, declared or unknown.
        camera: measured, declared, assumed or unknown.
        verdict: word of the run's verdict, None for an imported video.
        verdict_reasons: reasons of the verdict, the primary one first.
        verdict_sha256: hash of the runner's verdict.json, which lies outside the MCAP file; None
            where there is none.
        session_start_ns: stamp of the first RUNNING state, None for an imported video.
        imported: what the importer wrote, None for a session.
        twin: in what it differs from which recording, None unless it is a twin.
        redrawing: of which recording its pictures were drawn anew, None where they are its own.
        scene: what the server was that drew its pictures, None where CARLA drew none.
        plant: what the server was that moved its bodies, None where they are ours or real.
        probe: of that server, as it lies beside the bag; None: there is none.
        participation: what the participants of a session were, None for an imported video.
        declaration_sha256: hash of declaration.json, None where no declaration was given.
        seal: how the bag's seal stands to what is in it, and what can't be checked of the verdict;
            empty where that was not looked at.
    """

    name: str
    bag_sha256: str
    scenario: str | None
    domain: str
    domain_said_by: str
    event_version: str | None
    origin: str
    stand_in: bool
    ego: str
    camera: str
    verdict: str | None
    verdict_reasons: tuple[str, ...]
    verdict_sha256: str | None
    session_start_ns: int | None
    run: RunSpec | None
    imported: ImportRecord | None
    twin: str | None = None
    redrawing: Redrawing | None = None
    scene: CarlaScene | None = None
    plant: CarlaPlantRecord | None = None
    probe: ServerProbe | None = None
    participation: Participation | None = None
    declaration_sha256: str | None = None
    seal: str = ""

    @property
    def declared_by(self) -> str:
        """Name the person who declares its domain, with date and place; empty where none had to."""
        if self.imported is not None:
            declared = self.imported.declaration
            return "" if declared is None else declared.text.removeprefix("declared by ")
        return "" if self.participation is None else self.participation.said_by

    @property
    def driven_by(self) -> str:
        """Name the driver that led the VUT (METHOD 8); empty where none did."""
        driven = None if self.run is None else self.run.driven
        return "" if driven is None else driven.driver

    @property
    def is_undeclared(self) -> bool:
        """True for a physical session without a declaration of what took part in it."""
        part = self.participation
        return (
            part is not None
            and self.domain == "physical"
            and part.standing is Standing.UNDECLARED
            and not self.stand_in
        )

    @property
    def remark(self) -> str:
        """Describe what must stand beside its domain, for people; empty: nothing."""
        if self.stand_in:
            description = "a software stand-in, not a vehicle"
        elif self.is_undeclared:
            description = "undeclared"
        else:
            return f"{self.domain} by the word of {self.declared_by}" if self.declared_by else ""
        part = self.participation
        return f"{self.domain} is {description}" + ("" if part is None else f": {part.text}")

    @property
    def participants(self) -> Participants | None:
        """Return the participants with states in the bag; None without states of object targets."""
        if self.run is not None:
            return Participants(
                self.run.vut.id,
                {target.id: target.object_class for target in self.run.targets},
                tuple(one.id for one in self.run.traffic),
            )
        states = None if self.imported is None else self.imported.states
        return None if states is None else Participants(states.vut, states.objects)

    @property
    def road(self) -> Road | None:
        """The road that is bound to the recording; None where none is bound."""
        if self.run is not None:
            return self.run.road
        site = None if self.imported is None else self.imported.site
        return None if site is None else site.road

    @property
    def renderer(self) -> str | None:
        """Name what drew the pictures; None where a camera took them, or it is not stated."""
        if self.scene is not None and self.scene.counterpart:
            return COUNTERPART
        if self.redrawing is not None:
            return CARLA
        if self.imported is not None:
            made_by = self.imported.generator
            if made_by.startswith(_OUR_CLIPS):
                return OUR_RENDERER
            return None if made_by == "unknown" else made_by
        if self.run is None or self.participation is None:
            return None
        if self.run.mode == "live" and not self.run.stand_in:
            return OUR_RENDERER if CAMERA in self.participation.substitutes else None
        camera = self.run.camera
        return CARLA if camera is not None and camera.renderer == "carla" else OUR_RENDERER

    @property
    def carla_texts(self) -> dict[str, str]:
        """Describe the bodies in CARLA that drew or moved participants, for people."""
        bodies = {} if self.scene is None else self.scene.texts
        moved = {} if self.plant is None else self.plant.texts
        return {f"body of {name}": text for name, text in bodies.items()} | {
            f"moved by CARLA: {name}": text for name, text in moved.items()
        }

    @property
    def lacks_verdict(self) -> bool:
        """True for a session of which the runner's last word is missing.

        What went wrong after the session's own last word, a node that died or a bag that isn't
        whole, stands there alone, and an invalid run must never enter a mean.
        """
        return self.run is not None and self.verdict_sha256 is None

    @property
    def refusal(self) -> str | None:
        """Say why the recording can't be scored at all; None when it can."""
        if self.twin is not None:
            return f"it is a twin, of which no score means anything: {self.twin}"
        if self.participation is not None and self.participation.contradictions:
            return "; ".join(self.participation.contradictions)
        if self.verdict in (None, Verdict.VALID.name.lower()):
            return NO_VERDICT if self.lacks_verdict else None
        if self.verdict == Verdict.NONE.name.lower():
            return "the recording ends before the run got a verdict"
        why = "; ".join(self.verdict_reasons) or "no reason was recorded"
        return f"the run's verdict is {self.verdict}: {why}"


def bag_folder(bag: Path) -> Path:
    """Return the folder of a bag or of an MCAP file in it; a file by itself is returned as is."""
    return bag.parent if (bag.parent / "metadata.yaml").is_file() and bag.is_file() else bag


def read_provenance(bag: BagReader, digest: str | None = None) -> Provenance:
    """Read the provenance from the bag's attachments and session states.

    Args:
        bag: of a run or an import.
        digest: content_sha256 of it, for a caller who works it out meanwhile, and who takes the
            bag's seal as it was audited; None: both are worked out here.

    Raises:
        InputError: it has neither attachment, or one that is not valid; it was altered since it
            was sealed, or its verdict was.
    """
    if digest is None:
        seal = checked_seal(bag)
        return replace(_read(bag, content_sha256(bag)), seal=seal)
    return _read(bag, digest)


def checked_seal(bag: BagReader) -> str:
    """Describe whether a bag's seal fits its content, for people; every byte is read.

    Raises:
        InputError: the bag was altered since it was sealed, or its verdict was.
    """
    seal = read_seal(bag)
    check_unaltered(seal, bag.path)
    names = bag.attachments
    if seal.maker is None and RUN_ATTACHMENT in names and REPORT_NAME not in names:
        raise InputError(
            f"is a session's bag with neither seal nor {REPORT_NAME}: no recorder left it so",
            file=bag.path,
            remedy="take the bag as it was recorded",
        )
    damaged = next((one for one in seal.sources if one.is_damaged), None)
    if damaged is not None and RUN_ATTACHMENT in names and REPORT_NAME not in names:
        raise InputError(
            f"was made of {damaged.name}, {damaged.state}, and has no {REPORT_NAME}: which part "
            "of the session it lacks is unknown",
            file=bag.path,
            remedy="take the bag as it was recorded",
        )
    folder = bag.path if bag.path.is_dir() else bag.path.parent
    unbound = check_verdict(bag, seal, folder)
    return "; ".join(filter(None, (seal.text, *seal.lineage, unbound)))


def _read(bag: BagReader, digest: str) -> Provenance:
    run_data, import_data = bag.attachment(RUN_ATTACHMENT), bag.attachment(IMPORT_ATTACHMENT)
    if run_data is not None:
        return _session(bag, digest, run_data)
    if import_data is not None:
        return _imported(bag, digest, import_data)
    raise InputError(
        f"has neither the attachment {RUN_ATTACHMENT} nor {IMPORT_ATTACHMENT}",
        file=bag.path,
        remedy="evaluate takes bags of `ssp run` and of `ssp import-video`",
    )


def _verdict_with_hash(bag: Path) -> tuple[RecordedVerdict, str] | None:
    """Read the verdict in the bag's folder, and the file's hash; or None.

    Args:
        bag: the folder, or an MCAP file in it.

    Raises:
        InputError: the file is no verdict.
    """
    folder = bag if bag.is_dir() else bag.parent
    verdict = read_verdict(folder)
    return None if verdict is None else (verdict, sha256_file(folder / VERDICT_FILE))


def _twin_text(bag: BagReader) -> str | None:
    """Describe a twin by its attachment; None: the bag is none."""
    data = bag.attachment(TWIN_ATTACHMENT)
    if data is None:
        return None
    twin = parse_mapping(data, f"{bag.path}:{TWIN_ATTACHMENT}")
    return f"{twin.get('words')}, of {twin.get('of')}"


def _session(bag: BagReader, digest: str, data: bytes) -> Provenance:
    place = f"{bag.path}:{RUN_ATTACHMENT}"
    run = parse_model(RunSpec, parse_mapping(data, place), place)
    topic = absolute(SESSION_STATE)
    states = [bag.decode(message) for message in bag.messages([topic])]
    running = [stamp_ns(s.header.stamp) for s in states if s.state == SessionPhase.RUNNING]
    verdict = Verdict(states[-1].verdict) if states else Verdict.NONE
    reasons = tuple(str(reason) for reason in states[-1].reasons) if states else ()
    verdict_file = _verdict_with_hash(bag.path)
    if verdict_file is not None and verdict_file[0].verdict is not Verdict.VALID:
        # What went wrong after the session's last word is known to runner and recorder alone.
        verdict = verdict_file[0].verdict if verdict in (Verdict.VALID, Verdict.NONE) else verdict
        reasons = tuple(dict.fromkeys((*reasons, *verdict_file[0].reasons)))
    if not running:
        # Without a start there is no clip time; the verdict says why there was none.
        verdict = verdict if verdict is not Verdict.VALID else Verdict.INVALID_HARNESS
        reasons = (*reasons, "the session never reached RUNNING")
    folder = bag_folder(bag.path)
    participation = participation_of(bag, run, folder, digest)
    if bag.path.is_dir():
        check_result(run, participation, folder)
    word = folder / DECLARATION_FILE
    redrawing, scene = read_redrawing(bag), read_server(bag, CAMERA_RENDERER, CarlaScene)
    plant = read_server(bag, WORLD_PLANT, CarlaPlantRecord)
    return Provenance(
        name=bag_folder(bag.path).name,
        bag_sha256=digest,
        scenario=run.scenario,
        domain=run.domain,
        domain_said_by=f"by the session: {'live' if run.mode == 'live' else 'simulated'} run of "
        f"{run.compiler or 'a run file made by hand'}; {participation.text}",
        event_version=run.event_version,
        origin=f"session {run.run_id} at {run.site}, seed {run.seed}, {run.mode}"
        + ("" if redrawing is None else f", {redrawing.text}"),
        stand_in=run.stand_in
        or stands_in(run, participation)
        or (redrawing is not None and run.domain == "physical"),
        ego="measured",
        camera="measured",
        verdict=verdict.name.lower(),
        verdict_reasons=reasons,
        verdict_sha256=None if verdict_file is None else verdict_file[1],
        session_start_ns=min(running, default=None),
        run=run,
        imported=None,
        twin=_twin_text(bag),
        redrawing=redrawing,
        scene=scene,
        plant=plant,
        probe=None if scene is None and plant is None else read_probe(folder),
        participation=participation,
        declaration_sha256=sha256_file(word) if participation.said_by else None,
    )


def _seconds(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, int | float) else str(value)


def _imported(bag: BagReader, digest: str, data: bytes) -> Provenance:
    place = f"{bag.path}:{IMPORT_ATTACHMENT}"
    record = parse_model(ImportRecord, parse_mapping(data, place), place)
    crop = " to ".join(_seconds(record.crop.get(key)) for key in ("start_s", "end_s")) + " s"
    kind = record.source.get("kind", "video")
    declared = record.declaration
    names = ", ".join(record.accepted_names)
    accepted = f", accepted as it is: {names}" if names else ""
    redrawing, scene = read_redrawing(bag), read_server(bag, CAMERA_RENDERER, CarlaScene)
    return Provenance(
        name=bag_folder(bag.path).name,
        bag_sha256=digest,
        scenario=record.scenario,
        domain=record.domain,
        domain_said_by="not declared" if declared is None else declared.text,
        event_version=record.event_version,
        origin=f"{kind} {record.source_name}, {crop}, made by {record.generator}{accepted}"
        + ("" if redrawing is None else f", {redrawing.text}"),
        stand_in=redrawing is not None and record.domain == "physical",
        ego=record.ego.provenance,
        camera=record.camera.provenance,
        verdict=None,
        verdict_reasons=(),
        verdict_sha256=None,
        session_start_ns=None,
        run=None,
        imported=record,
        redrawing=redrawing,
        scene=scene,
        probe=None if scene is None else read_probe(bag_folder(bag.path)),
    )


AnyPath = TypeVar("AnyPath", Path, PurePosixPath)


def find_bag(path: Path) -> Path:
    """Return the bag of a path: the path itself, or ``bag/`` in a run folder.

    Raises:
        InputError: it is neither.
    """
    if (path / "metadata.yaml").is_file() or path.suffix == ".mcap":
        return path
    if (path / "bag" / "metadata.yaml").is_file():
        return path / "bag"
    raise InputError(
        "is neither a bag nor a folder with one in bag/",
        file=path,
        remedy="give the folder of `ssp run` or of `ssp import-video`",
    )


def find_labels(bag: Path) -> Path | None:
    """Return a bag's labels file: inside it, beside it as ``<bag>.labels.json``, or in its folder.

    Args:
        bag: its folder, or an MCAP file in it.
    """
    return next((path for path in labels_places(bag_folder(bag)) if path.is_file()), None)


def labels_places(bag: AnyPath) -> tuple[AnyPath, AnyPath, AnyPath]:
    """List the places where the labels of a bag may lie, in order.

    Args:
        bag: its folder, or an MCAP file that lies by itself.
    """
    return bag / "labels.json", beside_bag(bag), bag.parent / "labels.json"


def beside_bag(bag: AnyPath) -> AnyPath:
    """Return the place of labels beside a bag."""
    return bag.parent / f"{bag.name}.labels.json"
