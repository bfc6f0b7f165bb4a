"""METHOD 5.3, 5.4 and 6 read aloud in plain Python, record by record.

This is what somebody writes who wants the numbers of one cell and has the definitions beside him.
The benchmark measures the product against it, and a test holds the product to it: it shares no line
with ssp_eval.score.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from ssp_eval.data.labels import Label, Labels
from ssp_eval.data.records import BehaviourRecord, Slot

EPS = 1e-9
ADJACENT = {
    ("front", "front_left"),
    ("front", "front_right"),
    ("left", "front_left"),
    ("right", "front_right"),
    ("potential", "active"),
    ("no_conflict", "resolved"),
}


def match(labels: Sequence[Label], records: Sequence[BehaviourRecord]) -> list[int | None]:
    """6.1: most pairs, least total distance, earliest records."""
    rows, columns = len(labels), len(records)
    pairs = [[0] * (columns + 1) for _ in range(rows + 1)]
    error = [[0.0] * (columns + 1) for _ in range(rows + 1)]
    distance = [[abs(record.t_s - label.t_s) for record in records] for label in labels]
    for j in range(rows - 1, -1, -1):
        for i in range(columns - 1, -1, -1):
            best = max(
                (pairs[j + 1][i], -error[j + 1][i]),
                (pairs[j][i + 1], -error[j][i + 1]),
            )
            if distance[j][i] <= 0.11 + EPS:
                best = max(best, (pairs[j + 1][i + 1] + 1, -error[j + 1][i + 1] - distance[j][i]))
            pairs[j][i], error[j][i] = best[0], -best[1]
    result: list[int | None] = []
    start, spare = 0, EPS
    for j in range(rows):
        result.append(None)
        for i in range(start, columns):
            worse = error[j + 1][i + 1] + distance[j][i] - error[j][start]
            if (
                distance[j][i] <= 0.11 + EPS
                and 1 + pairs[j + 1][i + 1] == pairs[j][start]
                and worse <= spare
            ):
                result[j] = i
                start, spare = i + 1, spare - worse
                break
    return result


def answer(slot: Slot | None, text: str) -> Any:
    """5.3: the value of a slot if it has evidence in the text, else None."""
    if slot is None or not text.strip():
        return None
    for start, end in slot.evidence:
        if 0 <= start < end <= len(text):
            return slot.value
    return None


def trajectory_valid(record: BehaviourRecord) -> bool:
    """5.4."""
    path = record.trajectory
    if path is None or len(path.t_s) < 2:
        return False
    if len(path.x_m) != len(path.t_s) or len(path.y_m) != len(path.t_s):
        return False
    for values in (path.t_s, path.x_m, path.y_m):
        for value in values:
            if not math.isfinite(value):
                return False
    for k in range(1, len(path.t_s)):
        if path.t_s[k] <= path.t_s[k - 1]:
            return False
    return path.t_s[0] <= EPS and path.t_s[-1] >= 1.0 - EPS


def interpolate(times: Sequence[float], values: Sequence[float], at: float) -> float:
    """5.4: linear between samples; the end samples within the tolerance."""
    if at <= times[0]:
        return values[0]
    for k in range(1, len(times)):
        if at <= times[k]:
            share = (at - times[k - 1]) / (times[k] - times[k - 1])
            return 2 * (values[k - 1] / 2 + share * (values[k] / 2 - values[k - 1] / 2))
    return values[-1]


def motion(record: BehaviourRecord) -> tuple[str, str, bool]:
    """6.6: longitudinal action, lateral action, feasible."""
    path = record.trajectory
    assert path is not None
    s = [interpolate(path.t_s, path.x_m, at) for at in (0.0, 0.5, 1.0)]
    l = [interpolate(path.t_s, path.y_m, at) for at in (0.0, 0.5, 1.0)]  # noqa: E741 - METHOD's letter
    v2, shift = (s[2] - s[1]) / 0.5, l[2] - l[0]
    a = (s[2] - s[1] - (s[1] - s[0])) / 0.5 / 0.5
    if v2 <= 0.5 + EPS:
        lon = "stop"
    elif a <= -0.5 + EPS:
        lon = "decelerate"
    elif a >= 0.5 - EPS:
        lon = "accelerate"
    else:
        lon = "maintain"
    if shift >= 0.3 - EPS:
        lat = "left"
    elif shift <= -0.3 + EPS:
        lat = "right"
    else:
        lat = "straight"
    drivable = abs(a) <= 8 + EPS
    for k in (1, 2):
        ds, dl = s[k] - s[k - 1], l[k] - l[k - 1]
        drivable = (
            drivable
            and ds >= -0.2 - EPS
            and math.hypot(ds, dl) / 0.5 <= 25 + EPS
            and abs(dl) / 0.5 <= 5 + EPS
        )
    return lon, lat, drivable


def f1(given: Sequence[str], true: Sequence[str]) -> float:
    """6.3."""
    if not given and not true:
        return 1.0
    return 2 * len(set(given) & set(true)) / (len(set(given)) + len(set(true)))


def score(labels: Labels, records: Sequence[BehaviourRecord]) -> dict[str, Any]:
    """The score output of 6.14 for one cell."""
    n = len(labels.labels)
    onset = labels.risk_time_s
    if onset is None:
        onset = next(label.t_s for label in labels.labels if label.risk_visible)
    matched = jovr = e_sum = ez = ezh = ezs = interaction = correct = 0
    act = stfr = tqsr = atc = 0
    candidates: list[tuple[float, bool]] = []
    pairing = match(labels.labels, records)
    for j, label in enumerate(labels.labels):
        index = pairing[j]
        record = None if index is None else records[index]
        truths = [label.objects, label.position, label.motion, label.conflict]
        if j == 0 and not labels.first_frame_dynamics:
            truths[2] = truths[3] = None
        if truths[0] is not None and truths[1] is not None and truths[2] is not None:
            interaction += 1
        e_sum += sum(truth is not None for truth in truths)
        if record is None:
            continue
        matched += 1
        slots, text = record.slots, record.text
        hs = []
        for k, slot in enumerate((slots.objects, slots.position, slots.motion, slots.conflict)):
            truth, given = truths[k], answer(slot, text)
            if truth is None or given is None:
                hs.append(0.0)
                continue
            h = f1(given, truth) if k == 0 else float(given == truth)
            adjacent = k > 0 and ((given, truth) in ADJACENT or (truth, given) in ADJACENT)
            hs.append(h)
            ez += 1
            ezh += h
            ezs += 0.5 if adjacent else h
        if hs[0] == 1 and hs[1] == 1 and hs[2] == 1:
            correct += 1
        text_lon, text_lat = answer(slots.lon_action, text), answer(slots.lat_action, text)
        if text_lon in label.lon_actions and text_lat in label.lat_actions:
            act += 1
        lon = None
        if trajectory_valid(record):
            lon, lat, drivable = motion(record)
            jovr += bool(text.strip())
            stfr += drivable
            tqsr += drivable and lon in label.lon_actions and lat in label.lat_actions
            atc += text_lon == lon and text_lat == lat
        if record.t_s >= onset - EPS and label.conflict in ("potential", "active"):
            defensive = lon in ("decelerate", "stop") and lon in label.lon_actions
            candidates.append((record.t_s, defensive))
    rsr, rl_s = 0, None
    for (t0, first), (t1, second) in pairwise(candidates):
        if first and second and 0 < t1 - t0 <= 0.6 + EPS:
            rsr, rl_s = 1, max(0.0, t0 - onset)
            break
    sem_acc_eff = ezh / e_sum if e_sum else None
    cia_eff = correct / interaction if interaction else None
    return {
        "n": n,
        "matched": matched,
        "jovr": jovr / n,
        "sem_cov": ez / e_sum if e_sum else None,
        "sem_acc_cond": ezh / ez if ez else None,
        "sem_acc_eff": sem_acc_eff,
        "sem_acc_soft": ezs / e_sum if e_sum else None,
        "cia_eff": cia_eff,
        "act_acc_eff": act / n,
        "stfr": stfr / n,
        "tqsr": tqsr / n,
        "atc_eff": atc / n,
        "rsr": rsr,
        "rl_s": rl_s,
        "ivcs": 0.1 * jovr / n
        + 0.3 * (sem_acc_eff or 0)
        + 0.2 * (cia_eff or 0)
        + 0.3 * tqsr / n
        + 0.1 * rsr,
        "denominators": {"semantic": e_sum, "cia": interaction},
    }
