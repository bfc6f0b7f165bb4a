"""The fields of a line of component scores, each with what would be right where it is wrong."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from ssp_core.vocabulary import DOMAINS_READ, read_domain
from ssp_eval.analysis.matrix_table import NO, YES
from ssp_eval.analysis.row import MACRO, OK, CellRow
from ssp_eval.evaluate.controls import is_control_name
from ssp_eval.score import DEFAULT
from ssp_eval.score.show import NULL
from ssp_eval.strict import Place

# Null as tables write it: nothing, or a dash of any length.
_NULLS = ("", NULL, "—", "-", "−")
# Their denominator is the number of labels, which is never 0; without them there is no IVCS.
_NEVER_NULL = ("jovr", "tqsr")
_SCORES = (
    "jovr", "sem_acc_eff", "cia_eff", "act_acc_eff", "tqsr", "atc_eff", "sem_cov", "sem_acc_cond",
    "sem_acc_soft", "stfr",
)  # fmt: skip
_STATES = (OK, "refused", "failed")
_RESPONSE = re.compile(r"S@(\d+(?:\.\d+)?)", re.ASCII)
_DECIMAL = re.compile(r"[+-]?(\d+\.?(\d*)|\.(\d+))([eE][+-]?\d+)?", re.ASCII)
_COMMA = re.compile(r"[+-]?\d*,\d+", re.ASCII)
_SHA256 = re.compile(r"sha256:[0-9a-f]{64}")
_WHOLE = re.compile(r"\d{1,18}", re.ASCII)
# A text that a spreadsheet would take for a formula is written with this before it.
_GUARDED = re.compile(r"'[=+\-@\t\r]")


@dataclass(frozen=True)
class Given:
    """A number as it stands in a file: its value, and one unit of its last digit."""

    value: float
    unit: float


def parse_row(place: Place, fields: Mapping[str, str]) -> CellRow:
    """One line as a row.

    Args:
        place: of the line.
        fields: by the names of cells_csv, stripped.

    Raises:
        InputError: a value is wrong; with its column.
    """

    def text(name: str) -> str:
        found = fields.get(name, "")
        return found[1:] if _GUARDED.match(found) else found

    for name in ("scenario", "domain", "model"):
        if not fields[name]:
            raise place.at(name).error("is empty", remedy="name it")
    is_macro = [fields[name].casefold() == MACRO for name in ("scenario", "domain")]
    domain = MACRO if is_macro[1] else read_domain(fields["domain"])
    if domain is None:
        remedy = f"known are {DOMAINS_READ}, and {MACRO} for a published mean over them"
        raise place.at("domain").error("is no domain", fields["domain"], remedy)
    status = fields.get("status", "").casefold() or OK
    if status not in _STATES:
        raise place.at("status").error(
            "is no state of a cell", fields["status"], f"known are {', '.join(_STATES)}"
        )
    scores = {name: _share(place.at(name), fields.get(name, "")) for name in _SCORES}
    rsr, rl_s = (_macro_risk if any(is_macro) else _risk_of)(place, fields)
    _check_status(place, status, fields, {**scores, "rsr": rsr, "rl_s": rl_s})
    total_b, active_b = (
        _billions(place.at(name), fields.get(name, "")) for name in ("total_b", "active_b")
    )
    if total_b is not None and active_b is not None and active_b > total_b:
        raise place.at("active_b").error(
            "is more than total_b", fields["active_b"], f"at most {fields['total_b']}"
        )
    return CellRow(
        scenario=MACRO if is_macro[0] else text("scenario"),
        domain=domain,
        model=text("model"),
        **scores,
        rsr=rsr,
        rl_s=rl_s,
        n=_whole(place.at("n"), fields.get("n", ""), 1),
        run=text("run"),
        seed=_whole(place.at("seed"), fields.get("seed", ""), 0),
        total_b=total_b,
        active_b=active_b,
        architecture="" if text("architecture") in _NULLS else text("architecture"),
        control=is_control_name(text("model")) or _flag(place, fields, "control", NO),
        admitted=_flag(place, fields, "admitted", YES),
        stand_in=_flag(place, fields, "stand_in", NO),
        status=status,
        reason=text("reason"),
        thresholds=_hash(place.at("thresholds"), fields.get("thresholds", "")),
    )


def parse_ivcs(place: Place, field: str) -> Given | None:
    """What a file says IVCS is; None where it says nothing.

    Raises:
        InputError: it is no share.
    """
    value = _share(place, field)
    digits = _DECIMAL.fullmatch(field)
    if value is None or digits is None:
        return None
    shown = len(digits[2] or digits[3] or "")
    return Given(value, max(1e-9, 0.0 if digits[4] else 10.0**-shown))


def _check_status(
    place: Place, status: str, fields: Mapping[str, str], found: Mapping[str, float | None]
) -> None:
    if status == OK:
        for name in _NEVER_NULL:
            if found[name] is None:
                raise place.at(name).error(
                    "is never null: its denominator is the number of labels",
                    fields[name],
                    "give it, or leave the line out where the cell has no scores",
                )
        return
    for name, value in found.items():
        if value is not None:
            raise place.at(name).error(
                f"stands in a cell that is {status}, which has no scores",
                fields.get(name),
                f"leave it empty, or give {OK} as status",
            )


def _number(place: Place, text: str, remedy: str) -> float:
    digits = text.removesuffix("%").rstrip()
    if text.endswith("%") and _DECIMAL.fullmatch(digits):
        share = f"{float(digits) / 100:.6g}"
        raise place.error("is a percentage", text, f"write it as a share, {share}")
    if _COMMA.fullmatch(digits):
        point = digits.replace(",", ".")
        raise place.error("has a decimal comma", text, f"write it with a point, {point}")
    value = float(text) if _DECIMAL.fullmatch(text) else math.nan
    if not math.isfinite(value):
        raise place.error("is no number", text, remedy)
    return value


def _share(place: Place, text: str) -> float | None:
    if text in _NULLS:
        return None
    value = _number(place, text, f"give 0 to 1 with a decimal point, or {NULL} for null")
    if not 0.0 <= value <= 1.0:
        example = f"{value / 100:g} instead of {text}" if 1 < value <= 100 else "0.5 instead of 50"
        raise place.error("is outside 0 to 1", text, f"give it as a share, {example}")
    return value


def _billions(place: Place, text: str) -> float | None:
    if text in _NULLS:
        return None
    remedy = "give billions of parameters as a plain number, 7 for 7B, or nothing"
    value = _number(place, text, remedy)
    if value <= 0.0:
        raise place.error("must be positive", text, remedy)
    return value


def _whole(place: Place, text: str, least: int) -> int | None:
    if text in _NULLS:
        return None
    if not _WHOLE.fullmatch(text) or int(text) < least:
        raise place.error("is no whole number", text, f"give {least} or more, or nothing")
    return int(text)


def _hash(place: Place, text: str) -> str:
    if text and not _SHA256.fullmatch(text):
        remedy = "give sha256:<64 hex digits> of the scorer's thresholds, nothing for METHOD's"
        raise place.error("is no hash", text, remedy)
    return "" if text == DEFAULT.sha256 else text


def _flag(place: Place, fields: Mapping[str, str], name: str, usual: str) -> bool:
    text = fields.get(name, "").casefold() or usual
    if text not in (YES, NO):
        raise place.at(name).error("is neither yes nor no", fields[name], f"write {YES} or {NO}")
    return text == YES


def _risk_of(place: Place, fields: Mapping[str, str]) -> tuple[float | None, float | None]:
    """RSR and RL: of ``risk``, or where there is no such column of rsr and rl_s."""
    if "risk" in fields:
        return _risk(place.at("risk"), fields["risk"])
    text = fields["rsr"]
    if text in _NULLS:
        return None, None
    if _number(place.at("rsr"), text, "write 1 or 0") not in (0.0, 1.0):
        raise place.at("rsr").error(
            "is neither 1 nor 0",
            text,
            f"give each run of a cell a line of its own; of a mean over cells, write {MACRO} as "
            "its scenario, domain or both",
        )
    if float(text) == 0.0:
        return 0, None
    rl_s = _latency(place, fields)
    if rl_s is None:
        raise place.at("rl_s").error(
            "is missing for a response", remedy="give its latency in seconds"
        )
    return 1, rl_s


def _macro_risk(place: Place, fields: Mapping[str, str]) -> tuple[float | None, float | None]:
    """RSR of a macro row, the share of cells with a response, and the mean RL over these."""
    if "risk" in fields:
        raise place.at("risk").error(
            "is the response of a single cell, and this is a macro row",
            fields["risk"],
            "replace the column by rsr, the share of cells with a response (0 to 1), and rl_s, "
            "their mean latency in seconds, which may be empty",
        )
    rsr, rl_s = _share(place.at("rsr"), fields["rsr"]), _latency(place, fields)
    if rl_s is not None and not rsr:
        raise place.at("rl_s").error(
            "is given where no cell has a response", fields["rl_s"], "leave it empty"
        )
    return rsr, rl_s


def _latency(place: Place, fields: Mapping[str, str]) -> float | None:
    text = fields.get("rl_s", "")
    if text in _NULLS:
        return None
    value = _number(place.at("rl_s"), text, "write the latency in seconds")
    if value < 0.0:
        raise place.at("rl_s").error("is negative", text, "write the latency in seconds")
    return value


def _risk(place: Place, text: str) -> tuple[float | None, float | None]:
    if text in _NULLS:
        return None, None
    if text == "F":
        return 0, None
    found = _RESPONSE.fullmatch(text)
    if found is None:
        comma = re.fullmatch(r"S@\d+,\d+", text, re.ASCII)
        remedy = "write S@1.50 for one after 1.50 s, F for none"
        if comma:
            remedy = f"write it with a point, {text.replace(',', '.')}"
        raise place.error("is no risk response", text, remedy)
    return 1, _number(place, found[1], "write the latency in seconds")
