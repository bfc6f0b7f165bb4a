"""The models of a campaign: ``--bridge``, ``--attach``, the models file, and controls."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model, read_mapping
from ssp_core.run_file.values import Strict
from ssp_vla_bridge.adapters.registry import check_adapter
from ssp_vla_bridge.backend import (
    BACKENDS,
    OPTION_INTERFACE,
    OPTION_START,
    check_options,
    interface_of,
    is_blind,
    make_backend,
    parse_options,
)
from ssp_vla_bridge.backends import node, python
from ssp_vla_bridge.window import Interface, Preprocessing, find_interface

# In the options of a bridge these words stand for what only the cell knows.
LABELS_FILE = "{labels_file}"
CLIP_START_NS = "{clip_start_ns}"
# Options that nobody should have to type, by control: the privileged one needs both.
CONTROLS: dict[str, dict[str, Any]] = {
    "perfect": {"labels_file": LABELS_FILE, "clip_start_ns": CLIP_START_NS},
    "silent": {},
    "recorded": {},
}
# The best blind constant of a scenario (statistics/best_constant.py), chosen from labels.
BEST_CONSTANT = "best_constant"
# Whatever such a bridge is called, it is no model; a recording may be of one.
NEVER_MODELS = frozenset({"perfect", "silent"})

# What --controls adds: answerers, and conditions under which each model is asked once more.
ANSWERERS = ("constant_velocity", "copy_history", "perfect", "silent")
BLACK = "black"
SHUFFLED = "shuffled"
CONDITIONS = (BLACK, SHUFFLED)
# What --pictures adds: kinds of corruption (corruptions.py) in two strengths, frames that show
# nothing, and the control: frames that were decoded and encoded again, as corrupted ones are.
DROPPED = "dropped_frames"
CORRUPTIONS = ("noise", "blur", "fog", "low_light", "glare", DROPPED)
TEXT_ONLY = "pictures.text_only"
PICTURES_CONTROL = "pictures.control"
PICTURES = (
    *(f"pictures.{kind}.{strength}" for kind in CORRUPTIONS for strength in (1, 2)),
    TEXT_ONLY,
    PICTURES_CONTROL,
)
# What --reasoning adds: the model is given its own text back with one fact turned, or, as the
# control, as it was, and asked for the trajectory.
REASONING = "reasoning."
# The backend that can, and that can ask without pictures.
CHAT = "openai"
# A model of the chat backend with ``images: none``: it is asked in words alone.
BLIND = "blind"
# What --twins adds begins so, and the twin's name follows.
TWIN = "twin."
# What a condition begins with that isn't one of CONDITIONS, and changes one cause.
FAMILIES = ("pictures.", TWIN, REASONING)
# The question itself once more, after all others: what changes then has no cause at all.
REPEAT = "repeat"
# Of the order into which frames are put and of what is drawn in them; one for all campaigns, so
# that they can be compared.
CONDITION_SEED = 1


def condition_of(model: str) -> tuple[str, str]:
    """Name of the model and condition under which it was asked; empty where there is none."""
    name, _, last = model.rpartition("+")
    is_condition = last in (*CONDITIONS, BLIND, REPEAT) or last.startswith(FAMILIES)
    return (name, last) if name and is_condition else (model, "")


def is_control_name(model: str) -> bool:
    """Tell whether a name alone says that it is no model but a check of the harness."""
    return model in CONTROLS or model == BEST_CONSTANT or bool(condition_of(model)[1])


@dataclass(frozen=True)
class ModelFacts:
    """The facts that reports state of a model; none changes how it is asked or scored.

    Args:
        total_b: parameters, billions; None where it isn't stated.
        active_b: parameters that one token uses, billions; None where it isn't stated.
        architecture: a word such as ``dense`` or ``moe``; empty where it isn't stated.
    """

    total_b: float | None = None
    active_b: float | None = None
    architecture: str = ""


@dataclass(frozen=True)
class ModelSpec:
    """One model of a campaign.

    Args:
        options: of its backend; placeholders stand for what differs from cell to cell.
        attached: its bridge runs already, and isn't ours to start or stop.
        backend: name of a backend or ``module:factory``; empty: the model's name.
        interface: that it speaks; empty: the one of its backend and options.
        adapter: that reads its answers, ``name`` or ``name:mode``; empty: the interface's.
        timeout_s: for one answer; None: the campaign's.
        preprocessing: what differs from the interface's, by field of Preprocessing.
        condition: under which it is asked (conditions.py); empty: as it is meant to be.
        control: it was added to check the harness, whatever it is; it enters no mean and no rank.
        answerer: it is one of the harness's own that was added; it needs no start.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    attached: bool = False
    backend: str = ""
    interface: str = ""
    adapter: str = ""
    timeout_s: float | None = None
    preprocessing: Mapping[str, Any] = field(default_factory=dict)
    facts: ModelFacts = ModelFacts()
    condition: str = ""
    control: bool = False
    answerer: bool = False

    @property
    def result_name(self) -> str:
        """Its name in results, such as ``mine+black``: under a condition it is another cell."""
        return f"{self.name}+{self.condition}" if self.condition else self.name

    @property
    def backend_name(self) -> str:
        """The backend that answers; of an attached bridge it is known only if somebody says."""
        return self.backend or self.name

    @property
    def model_interface(self) -> Interface:
        """Return the model's interface.

        Raises:
            InputError: there is no such interface.
        """
        return find_interface(self.interface or interface_of(self.backend_name, self.options))

    @property
    def rules(self) -> Preprocessing:
        """Return the choice of frames and ego samples for its requests."""
        return replace(self.model_interface.preprocessing, **self.preprocessing)

    def read_by(self, override: str = "") -> str:
        """Return the adapter with its mode, as it stands in results.

        Args:
            override: adapter of the whole campaign; empty: the model's own.

        Raises:
            InputError: there is no such adapter.
        """
        return ":".join(check_adapter(override or self.adapter or self.model_interface.adapter))

    def options_for(self, labels_file: str, clip_start_ns: int) -> dict[str, Any]:
        """Return the backend's options for one cell, or what stands for them in a key."""
        return _filled(self.options, {LABELS_FILE: labels_file, CLIP_START_NS: clip_start_ns})


def _filled(options: Mapping[str, Any], places: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: places.get(value, value) if isinstance(value, str) else value
        for key, value in options.items()
    }


# By name: api_key, x-api-key, authorization, secret, hf_token; not max_tokens, not api_key_env.
_SECRET_NAME = re.compile(
    r"(?:.*_)?(?:api_?key|secret|secret_key|password|passwd|authorization|credentials?|bearer)"
    r"|(?:(?:api|access|auth|bearer|secret|hf|service|refresh|id)_)?token|key"
)
# By value: what the vendors give out, an authorization header, a password in an address.
_VALUE = re.compile(
    r"\b(?:sk|pk|rk|hf|gsk|xai|ghp|AIza)[-_]?[A-Za-z0-9_-]{20,}|\b[Bb]earer\s+\S{8,}|://[^/\s@:]*:[^/\s@]+@"
)
_REMEDY = "put it into an environment variable and name that with the option api_key_env"


def refuse_secrets(value: Any, file: str | None = None, field: str = "") -> None:
    """Refuse what is or looks like a key, wherever it stands; the message doesn't repeat it.

    Raises:
        InputError: with the field, and where a key may stand instead.
    """
    if isinstance(value, dict):
        for key, inner in value.items():
            place = f"{field}.{key}" if field else str(key)
            name = str(key).lower().replace("-", "_")
            if (
                _SECRET_NAME.fullmatch(name)
                and inner is not None
                and not isinstance(inner, dict | bool)
            ):
                raise InputError("is a secret's place", file=file, field=place, remedy=_REMEDY)
            refuse_secrets(inner, file, place)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            refuse_secrets(inner, file, f"{field}[{index}]")
    elif isinstance(value, str) and _VALUE.search(value):
        raise InputError("looks like a secret", file=file, field=field or None, remedy=_REMEDY)


SCHEMA = "ssp.models/1"
# A model's name is a part of topics and of a cell's folder name.
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")

Seconds = Annotated[float, Field(ge=0.0, le=600.0)]


class ModelEntry(Strict):
    """One model of a models file."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    backend: str = Field("", description="name of a backend, or module:factory")
    attached: bool = Field(False, description="true where the bridge runs already")
    interface: str = Field("", description="name of an interface")
    adapter: str = Field("", description="an adapter, name or name:mode")
    timeout_s: float | None = Field(None, ge=0.1, le=86400.0, description="0.1 to 86400 s")
    options: dict[str, Any] = Field({}, description="a mapping of the backend's options")
    frames: int | None = Field(None, ge=1, le=100, description="a whole number from 1 to 100")
    frame_spacing_s: Seconds | None = Field(None, description="0 to 600 s")
    frame_span_s: Seconds | None = Field(None, description="0 to 600 s")
    history_s: Seconds | None = Field(None, description="0 to 600 s")
    history_spacing_s: float | None = Field(None, ge=0.01, le=600.0, description="0.01 to 600 s")
    total_b: float | None = Field(None, gt=0.0, description="billions of parameters, above 0")
    active_b: float | None = Field(None, gt=0.0, description="billions of parameters, above 0")
    architecture: str = Field("", description="a word such as dense or moe")
    weights_sha256: str = Field("", description="the hash of its weights, for cards of drivers")
    centre_line: bool = Field(
        False, description="true where, as a driver, it is given the centre line of its lane"
    )


class ModelsFile(Strict):
    """``ssp.models/1``."""

    schema_: Literal["ssp.models/1"] = Field(alias="schema", description=SCHEMA)
    models: dict[str, ModelEntry] = Field(min_length=1, description="at least one model by name")


# Keys of an entry that may stand beside the backend's options in --bridge NAME={...}.
_BESIDE = ("backend", "adapter", "timeout_s", "centre_line")
_PREPROCESSING = tuple(set(asdict(Preprocessing())) & set(ModelEntry.model_fields))


def load_models(path: Path) -> list[ModelSpec]:
    """Return the models of a models file, in its order.

    Raises:
        InputError: with file, field, value and what would be right.
    """
    value = read_mapping(path)
    refuse_secrets(value, str(path))
    entries = value.get("models")
    for name, entry in entries.items() if isinstance(entries, dict) else ():
        _check_keys(entry, str(path), f"models.{name}")
    try:
        file = parse_model(ModelsFile, value, path)
    except InputError as error:
        raise error.each(_with_remedy) from error
    specs = [_spec(name, entry) for name, entry in file.models.items()]
    for spec in specs:
        check_model(spec, str(path), f"models.{spec.name}")
    return specs


def bridge_spec(text: str) -> ModelSpec:
    """Return a model of ``NAME`` or ``NAME={"backend": …, "adapter": …, "timeout_s": …, options}``.

    Raises:
        InputError: what follows the name is no JSON object, or a value in it is wrong.
    """
    name, value = _parts("--bridge", text, '{"backend": "python", …}')
    return entry_spec(name, beside_options(value))


def beside_options(value: Mapping[str, Any]) -> dict[str, Any]:
    """Return what stands behind ``NAME=`` as an entry of a models file."""
    options = {key: inner for key, inner in value.items() if key not in _BESIDE}
    entry = {key: value[key] for key in _BESIDE if key in value}
    return {**entry, "options": options}


def attached_spec(text: str) -> ModelSpec:
    """Return a model from ``NAME`` or ``NAME={"interface": …, "adapter": …, "timeout_s": …}``.

    Raises:
        InputError: what follows the name is no JSON object of keys of a model.
    """
    name, value = _parts("--attach", text, '{"interface": "waypoints"}')
    return entry_spec(name, {**value, "attached": True})


def _parts(option: str, text: str, example: str) -> tuple[str, dict[str, Any]]:
    """Return the name and the values of ``NAME`` or ``NAME={…}``."""
    name, _, options_text = text.partition("=")
    remedy = f"write {option} '{name}={example}', for a shell in single quotes as it stands here"
    return name, parse_options(options_text, f"{option} {name}", remedy)


def entry_spec(name: str, value: dict[str, Any]) -> ModelSpec:
    """Return the model of an entry of a models file that stands in no file.

    Raises:
        InputError: a key or a value is wrong.
    """
    refuse_secrets(value, field=name)
    _check_keys(value, None, name)
    try:
        file = parse_model(ModelsFile, {"schema": SCHEMA, "models": {name: value}}, "")
    except InputError as error:
        raise error.each(_with_remedy) from error
    spec = _spec(name, file.models[name])
    check_model(spec, None, name)
    return spec


def _check_keys(entry: Any, file: str | None, field: str) -> None:
    """Refuse unknown keys first: an option in the wrong place is the commonest mistake."""
    for key in entry if isinstance(entry, dict) else ():
        if key not in ModelEntry.model_fields:
            raise InputError(
                "is no key of a model",
                file=file,
                field=f"{field}.{key}",
                remedy=f"known: {', '.join(ModelEntry.model_fields)}; what the backend is to "
                "know stands under options",
            )


def _with_remedy(error: InputError) -> InputError:
    """Return the refusal with a remedy from the field's description."""
    field = error.field or ""
    last = re.split(r"[.\[]", field)[-1]
    of: type[Strict] = ModelEntry if field.startswith("models.") else ModelsFile
    descriptions = {info.alias or name: info.description for name, info in of.model_fields.items()}
    return InputError(
        error.problem,
        file=error.file or None,
        field=field,
        value=error.value,
        remedy=f"give {descriptions[last]}" if descriptions.get(last) else error.remedy,
    )


def _spec(name: str, entry: ModelEntry) -> ModelSpec:
    backend = entry.backend or name
    options = {**({} if entry.attached else CONTROLS.get(backend, {})), **entry.options}
    if entry.interface and backend in OPTION_INTERFACE and not entry.attached:
        # Requests and prompts have to be of the same interface.
        options.setdefault("interface", entry.interface)
    preprocessing = {key: getattr(entry, key) for key in _PREPROCESSING}
    blind = backend == CHAT and is_blind(options)
    return ModelSpec(
        name,
        options,
        attached=entry.attached,
        backend=entry.backend,
        interface=entry.interface,
        adapter=entry.adapter,
        timeout_s=entry.timeout_s,
        preprocessing={key: value for key, value in preprocessing.items() if value is not None},
        facts=ModelFacts(entry.total_b, entry.active_b, entry.architecture),
        condition=BLIND if blind else "",
        control=blind,
    )


def check_model(spec: ModelSpec, file: str | None = None, field: str = "") -> None:
    """Refuse what can be seen without making the backend: names, interface, adapter.

    Raises:
        InputError: with the field.
    """
    if not _NAME.fullmatch(spec.name):
        raise InputError(
            "is no name for a topic",
            file=file,
            field="models" if file else "bridge",
            value=spec.name,
            remedy="use letters, digits and underscores, a letter first, 64 at most",
        )
    is_reserved = spec.name in {*CONTROLS, *ANSWERERS} and spec.backend not in ("", spec.name)
    if is_reserved or spec.name == BEST_CONSTANT:
        # Its cells would be taken for those of the answerer, and be replaced by them.
        raise InputError(
            "is the name of an answerer of ours, and can't be that of another backend",
            file=file,
            field="models" if file else "bridge",
            value=spec.name,
            remedy="name the model otherwise",
        )
    if spec.attached and (spec.backend or spec.options):
        raise InputError(
            "an attached bridge has its backend and options already",
            file=file,
            field=f"{field}.{'backend' if spec.backend else 'options'}",
            remedy="give them to the bridge, or leave out attached",
        )
    total_b, active_b = spec.facts.total_b, spec.facts.active_b
    if total_b is not None and active_b is not None and active_b > total_b:
        raise InputError(
            f"is more than the model has, {total_b:g} (total_b)",
            file=file,
            field=f"{field}.active_b",
            value=active_b,
            remedy="give the parameters that one token uses, in billions as total_b",
        )
    interface = spec.options.get("interface")
    if spec.interface and interface is not None and interface != spec.interface:
        raise InputError(
            f"is {interface!r}, and the model's interface is {spec.interface!r}",
            file=file,
            field=f"{field}.options.interface",
            remedy="give one of them",
        )
    try:
        if spec.interface:
            find_interface(spec.interface)
        spec.read_by()
    except InputError as error:
        raise InputError(
            error.problem,
            file=file,
            field=f"{field}.{error.field}" if field else error.field,
            value=error.value,
            remedy=error.remedy,
        ) from error


def as_attached(specs: list[ModelSpec]) -> list[ModelSpec]:
    """Return the same models as bridges that run already: backend and options are theirs."""
    return [
        replace(spec, attached=True, interface=spec.model_interface.name, backend="", options={})
        for spec in specs
    ]


def check_bridge(model: ModelSpec) -> None:
    """Refuse a bridge that can't be started here, before anything is asked.

    A backend or function of one's own isn't loaded here: it may be a model that fills a graphics
    card.

    Raises:
        InputError: no backend has that name, or its options are wrong.
    """
    backend = model.backend_name
    if backend not in BACKENDS and ":" not in backend:
        raise InputError(
            "no such bridge",
            field="bridge",
            value=backend,
            remedy=f"known: {', '.join(sorted(BACKENDS))}, and module:factory; a model of "
            'another name says which it is, NAME={"backend": …}; a node of your own is started by '
            "itself and named with --attach",
        )
    spoken = interface_of(backend, model.options)
    if backend in BACKENDS and model.model_interface.name != spoken:
        raise InputError(
            f"speaks {spoken}, not {model.model_interface.name}",
            field="bridge",
            value=backend,
            remedy="leave out the interface",
        )
    filled = ModelSpec(model.name, CONTROLS.get(backend, {})).options_for("", 0)
    if filled:
        # What only the cell knows isn't there yet; names and types can be checked without it.
        option_types = {key: type(value) for key, value in filled.items()}
        check_options(backend, model.options_for("", 0), option_types)
    elif backend == "python":
        python.check(model.options)
    elif backend == "node":
        node.read_options(model.options)
    elif backend in BACKENDS:
        # Only options are checked: a service behind the backend isn't waited for.
        at_once = {"start_s": 0.0} if backend in OPTION_START else {}
        make_backend(backend, {**model.options, **at_once})
