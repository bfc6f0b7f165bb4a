"""The topics of a graph that are recorded."""

from __future__ import annotations

import warnings

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_monitor.recorder.report import MOST, RepeatedWarnings
from ssp_monitor.recorder.topics import Pattern, Profile, Selection, TopicDiscovery

STRING = "std_msgs/msg/String"


def installed_type(_: str) -> None:
    """Every type is."""


def patterns(*texts: str) -> tuple[Pattern, ...]:
    return tuple(Pattern(text, "--include") for text in texts)


@pytest.mark.parametrize(
    ("selection", "wanted"),
    [
        (Selection(), ""),
        (Selection(everything=True), "/a /b/image /b/image/compressed"),
        (Selection(include=patterns("image$")), "/b/image"),
        (Selection(include=patterns("^/a$", "compressed")), "/a /b/image/compressed"),
        (Selection(everything=True, exclude=patterns("image")), "/a"),
        (Selection(include=patterns("/b"), exclude=patterns("/image$")), "/b/image/compressed"),
        (Selection(include=patterns("."), own=frozenset(["/a"])), "/b/image /b/image/compressed"),
        # A name is a name, whatever else is said.
        (Selection(named=frozenset(["/rosout"])), "/rosout"),
        (Selection(named=frozenset(["/x/_hidden"]), exclude=patterns("x")), "/x/_hidden"),
    ],
)
def test_what_is_asked_for_is_recorded(selection, wanted):
    graph = [
        "/a",
        "/b/image",
        "/b/image/compressed",
        "/rosout",
        "/parameter_events",
        "/x/_hidden",
        "/_all/hidden",
    ]
    assert [name for name in graph if selection.wants(name)] == wanted.split()
    assert selection.looks == (selection != Selection())
    found = TopicDiscovery(selection).look([(name, [STRING]) for name in graph], installed_type)
    assert sorted(topic.name for topic in found) == sorted(wanted.split())
    for topic in found:
        assert topic.profile is Profile.ADAPTED
        assert not any((topic.session_time, topic.required))


def test_late_topics_are_found_once():
    survey = TopicDiscovery(Selection(everything=True))
    assert [t.name for t in survey.look([("/a", [STRING])], installed_type)] == ["/a"]
    # No publisher yet.
    assert survey.look([("/a", [STRING]), ("/b", [])], installed_type) == []
    found = survey.look([("/a", [STRING]), ("/b", [STRING])], installed_type)
    assert [t.name for t in found] == ["/b"]
    # A topic that goes away and comes back is the same.
    assert survey.look([], installed_type) == survey.look([("/a", [STRING])], installed_type) == []
    assert survey.all_warnings() == []


def test_two_types_at_once_are_refused_with_a_word():
    survey = TopicDiscovery(Selection(everything=True))
    for _ in range(3):
        assert survey.look([("/a", ["x/msg/X", STRING])], installed_type) == []
    warning = f"/a has several types and is not recorded: x/msg/X, {STRING}"
    assert survey.all_warnings() == [warning]
    assert survey.ambiguous == {"/a"}
    # Once one of them is gone, the other is recorded.
    assert [t.msgtype for t in survey.look([("/a", [STRING])], installed_type)] == [STRING]
    assert survey.ambiguous == set()
    settled = "/a had several types at first and is recorded since it has one"
    assert survey.all_warnings() == [settled]


def test_a_type_that_is_not_installed_is_refused_with_a_word():
    survey = TopicDiscovery(Selection(everything=True))
    installed = {"x/msg/X": "message type x/msg/X is not installed", STRING: None}
    for _ in range(2):
        found = survey.look([("/a", ["x/msg/X"]), ("/b", [STRING])], installed.__getitem__)
    assert found == []
    assert set(survey.recorded) == {"/b"}
    assert survey.all_warnings() == ["/a is not recorded: message type x/msg/X is not installed"]


def test_a_topic_that_changes_its_type_is_said_once_and_remembered():
    survey = TopicDiscovery(Selection(everything=True))
    survey.look([("/a", [STRING])], installed_type)
    for _ in range(2):
        assert survey.look([("/a", [STRING, "x/msg/X"])], installed_type) == []
    assert survey.changed == {"/a"}
    assert survey.all_warnings() == [
        f"/a is also of type x/msg/X now: only {STRING} is recorded, the rest is lost"
    ]


def test_beyond_the_limit_named_topics_come_first_and_the_rest_is_said():
    survey = TopicDiscovery(Selection(everything=True, named=frozenset(["/z"]), most=3))
    graph = [(f"/t{k}", [STRING]) for k in range(9)] + [("/z", [STRING])]
    assert [t.name for t in survey.look(graph, installed_type)] == ["/z", "/t0", "/t1"]
    assert survey.look(graph, installed_type) == []
    assert survey.all_warnings() == [
        "7 topics are not recorded, the limit is 3: /t2, /t3, /t4, /t5, /t6, ..."
    ]


def test_a_warning_whose_figures_move_is_one_warning():
    sayings = RepeatedWarnings()
    assert sayings.say("the disk is full in 599 s: 12.5 MB left")
    assert not sayings.say("the disk is full in 20 s: 0.1 MB left")
    # A number in a name is no figure.
    assert sayings.say("/cam1/image has several types")
    assert sayings.say("/cam2/image has several types")
    assert sayings.say("/t/3 has several types")
    assert sayings.say("/t/4 has several types")
    assert sayings.texts()[:2] == [
        "the disk is full in 20 s: 0.1 MB left",
        "/cam1/image has several types",
    ]
    for number in range(MOST):
        sayings.say(f"/x{number} is odd")
    assert len(sayings.texts()) == MOST


@pytest.mark.parametrize(
    "text",
    [
        "(",
        ")",
        "a)",
        "(a",
        "[a",
        "[",
        "*",
        "a**",
        "+a",
        "a|*",
        "\\1",
        "a\\",
        "[b-a]",
        "a" * 1001,
        "(" * 500 + ")" * 500,
        "a{99999999999}",
    ],
)
def test_what_is_no_expression_is_refused(text):
    with pytest.raises(InputError, match="--exclude"):
        Pattern(text, "--exclude")


@given(st.text(max_size=30))
def test_any_text_is_an_expression_or_an_input_error(text):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # what re says of [[
        try:
            pattern = Pattern(text, "x")
        except InputError:
            return
    assert pattern.occurs_in("/ssp/vut/state") in (True, False)


def test_an_expression_may_match_anywhere_unless_it_names_an_end():
    assert Pattern("/b", "x").occurs_in("/a/b")
    assert Pattern("^/a", "x").occurs_in("/a/b")
    assert not Pattern("^/a", "x").occurs_in("/b/a")
    assert not Pattern(".", "x").occurs_in("")
    assert Pattern("^$", "x").occurs_in("")


def test_digits_and_words_are_those_of_ros_names():
    assert not Pattern("\\d|\\w", "x").occurs_in("\u0663\u00e9")
