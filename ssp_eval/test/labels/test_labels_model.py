"""Labels files (METHOD 5.2, 5.6): what is read, what is refused, round trips."""

import copy
import json
import math

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_eval.data.labels import Label, Labels, labels_to_json, load_labels, parse_labels

LABEL = {
    "t_s": 0.0,
    "phase": "approach",
    "risk_visible": False,
    "objects": ["car"],
    "position": "front_right",
    "motion": "same_direction",
    "conflict": "no_conflict",
    "lon_actions": ["maintain"],
    "lat_actions": ["straight"],
}
GOOD = {
    "schema": "ssp.labels/1",
    "scenario": "cut_in",
    "domain": "simulation",
    "event_version": "sha256:0",
    "risk_time_s": 2.0,
    "first_frame_dynamics": False,
    "labels": [LABEL, LABEL | {"t_s": 0.5, "risk_visible": True}],
}
REMOVE = object()


def changed(path, value):
    """GOOD with one value replaced, added or (REMOVE) taken away; path is ``a.b.0``."""
    content = copy.deepcopy(GOOD)
    *parents, last = path.split(".")
    holder = content
    for key in parents:
        holder = holder[int(key) if isinstance(holder, list) else key]
    key = int(last) if isinstance(holder, list) else last
    if value is REMOVE:
        del holder[key]
    else:
        holder[key] = value
    return content


def in_yaml(**options):
    """GOOD as YAML; the detour keeps lists that it shares from becoming aliases."""
    return yaml.safe_dump(json.loads(json.dumps(GOOD)), **options)


def test_a_file_is_read_as_it_stands(tmp_path):
    path = tmp_path / "labels.json"
    path.write_text(json.dumps(GOOD))
    first = Label(
        0.0,
        "approach",
        False,
        ("car",),
        "front_right",
        "same_direction",
        "no_conflict",
        ("maintain",),
        ("straight",),
    )
    labels = load_labels(path)
    assert labels == Labels("cut_in", "simulation", "sha256:0", 2.0, False, labels.labels)
    assert labels.labels[0] == first
    assert [label.t_s for label in labels.labels] == [0.0, 0.5]


@pytest.mark.parametrize("slot", ["objects", "position", "motion", "conflict"])
def test_null_slots_and_an_empty_set_are_kept_apart(slot):
    labels = parse_labels(changed(f"labels.1.{slot}", None), "l.json")
    assert getattr(labels.labels[1], slot) is None
    assert parse_labels(changed("labels.1.objects", []), "l.json").labels[1].objects == ()


def test_words_repeated_in_a_set_count_once():
    content = changed("labels.0.objects", ["car", "bus", "car"])
    assert parse_labels(content, "l.json").labels[0].objects == ("car", "bus")


def test_risk_onset_is_the_given_time_else_the_first_visible_label():
    assert parse_labels(GOOD, "l.json").risk_onset_s == 2.0
    assert parse_labels(changed("risk_time_s", None), "l.json").risk_onset_s == 0.5
    assert parse_labels(changed("risk_time_s", 0), "l.json").risk_onset_s == 0.0


REFUSED = [
    ("schema", "ssp.labels/2", "schema"),
    ("schema", None, "schema"),
    *[(key, REMOVE, key) for key in GOOD],
    *[(f"labels.1.{key}", REMOVE, f"labels[1].{key}") for key in LABEL],
    ("note", "x", "note"),
    ("labels.1.note", "x", "labels[1].note"),
    ("scenario", " ", "scenario"),
    ("scenario", 3, "scenario"),
    ("domain", "moon", "domain"),
    ("domain", ["physical"], "domain"),
    ("event_version", None, "event_version"),
    ("event_version", "", "event_version"),
    ("risk_time_s", "2.0", "risk_time_s"),
    ("risk_time_s", math.nan, "risk_time_s"),
    ("risk_time_s", True, "risk_time_s"),
    ("first_frame_dynamics", None, "first_frame_dynamics"),
    ("first_frame_dynamics", 0, "first_frame_dynamics"),
    ("labels", [], "labels"),
    ("labels", {}, "labels"),
    ("labels", None, "labels"),
    ("labels.0", None, "labels[0]"),
    ("labels.1.t_s", None, "labels[1].t_s"),
    ("labels.1.t_s", math.inf, "labels[1].t_s"),
    ("labels.1.t_s", 10**400, "labels[1].t_s"),
    ("labels.1.t_s", 0.0, "labels[1].t_s"),
    ("labels.1.t_s", -1.0, "labels[1].t_s"),
    ("labels.1.phase", "later", "labels[1].phase"),
    ("labels.1.phase", None, "labels[1].phase"),
    ("labels.1.risk_visible", 1, "labels[1].risk_visible"),
    ("labels.1.risk_visible", None, "labels[1].risk_visible"),
    ("labels.1.objects", "car", "labels[1].objects"),
    ("labels.1.objects", ["car", "tram"], "labels[1].objects[1]"),
    ("labels.1.objects", [None], "labels[1].objects[0]"),
    ("labels.1.position", "ahead", "labels[1].position"),
    ("labels.1.position", False, "labels[1].position"),
    ("labels.1.motion", "flying", "labels[1].motion"),
    ("labels.1.conflict", "maybe", "labels[1].conflict"),
    ("labels.1.conflict", [], "labels[1].conflict"),
    ("labels.1.lon_actions", [], "labels[1].lon_actions"),
    ("labels.1.lon_actions", None, "labels[1].lon_actions"),
    ("labels.1.lon_actions", "stop", "labels[1].lon_actions"),
    ("labels.1.lon_actions", ["brake"], "labels[1].lon_actions[0]"),
    ("labels.1.lat_actions", [], "labels[1].lat_actions"),
    ("labels.1.lat_actions", ["straight", "up"], "labels[1].lat_actions[1]"),
]


@pytest.mark.parametrize(("path", "value", "field"), REFUSED)
def test_refusals_name_file_and_field(path, value, field):
    with pytest.raises(InputError) as caught:
        parse_labels(changed(path, value), "l.json")
    assert (caught.value.file, caught.value.field) == ("l.json", field)
    assert str(caught.value).startswith(f"l.json: {field}: ")


def test_a_file_without_any_risk_onset_is_refused():
    content = changed("risk_time_s", None)
    content["labels"][1]["risk_visible"] = False
    with pytest.raises(InputError, match="risk_time_s: is null, and no label has risk_visible"):
        parse_labels(content, "l.json")


@pytest.mark.parametrize("name", ["labels.yaml", "labels.yml", "labels"])
def test_yaml_with_the_same_keys_is_accepted(tmp_path, name):
    path = tmp_path / name
    path.write_text("# by hand\n" + in_yaml())
    assert load_labels(path) == parse_labels(GOOD, "l.json")


def test_yaml_in_flow_style_is_accepted(tmp_path):
    path = tmp_path / "labels.yaml"
    path.write_text(in_yaml(default_flow_style=True))
    assert load_labels(path) == parse_labels(GOOD, "l.json")


@pytest.mark.parametrize("name", ["labels.json", "labels.yaml"])
def test_json_numbers_that_yaml_takes_for_words_are_numbers(tmp_path, name):
    path = tmp_path / name
    path.write_text(json.dumps(changed("labels.0.t_s", 1e-5)))
    assert "1e-05" in path.read_text()
    assert load_labels(path).labels[0].t_s == 1e-5


def test_bom_and_crlf_are_accepted(tmp_path):
    for name, text in (
        ("labels.json", json.dumps(GOOD, indent=1)),
        ("labels.yaml", in_yaml()),
    ):
        path = tmp_path / name
        path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
        assert load_labels(path) == parse_labels(GOOD, "l.json")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "null",
        "[]",
        "3",
        '"labels"',
        "{",
        "[" * 100_000,
        '{"schema": 1, "schema": 2}',
        "labels: *a",
        "a: [1\nb: 2",
        "\x00",
        "{}{}",
        "9" * 5000,
        "t_s: 0x" + "f" * 5000,
        "when: 2001-99-99",
        "? [a, b]\n: 1",
    ],
    ids=lambda text: ascii(text)[:12],
)
@pytest.mark.parametrize("name", ["labels.json", "labels.yaml"])
def test_garbage_is_refused_by_file_name(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_labels(path)
    assert caught.value.file == str(path)
    assert len(str(caught.value)) < 500 + len(str(path))


def test_a_syntax_error_in_json_names_its_line(tmp_path):
    path = tmp_path / "labels.json"
    path.write_text(json.dumps(GOOD, indent=1).replace('"domain":', '"domain"'))
    with pytest.raises(InputError, match=r"labels\.json:4: is not valid YAML or JSON"):
        load_labels(path)


def test_a_key_that_stands_twice_in_json_is_refused(tmp_path):
    path = tmp_path / "labels.json"
    path.write_text(json.dumps(GOOD).replace('"motion"', '"position"', 1))
    with pytest.raises(InputError, match="key 'position' stands twice"):
        load_labels(path)


def test_writing_and_reading_give_the_same_labels(tmp_path):
    assert labels_to_json(parse_labels(GOOD, "l.json")) == GOOD
    nulls = changed("labels.0.objects", None)
    assert labels_to_json(parse_labels(nulls, "l.json")) == nulls


any_value = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4) | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=5,
)
PLACES = [*GOOD, "labels.0", *(f"labels.1.{key}" for key in LABEL)]


@settings(max_examples=100, deadline=None)
@given(place=st.sampled_from(PLACES), value=any_value)
def test_any_value_anywhere_is_read_or_refused_by_field(place, value):
    try:
        refusal = None
        parse_labels(changed(place, value), "l.json")
    except InputError as error:
        refusal = error
    assert refusal is None or all(one.field for one in refusal.parts or (refusal,))
