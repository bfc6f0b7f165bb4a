"""Questions to LLMs, as far as no server is needed: patience, keys, and what a reply says.

How the client fares with real services is tested where it is used: ssp_vla_bridge/test/openai,
ssp_scenario_manager/test/extract/test_extract_bad_answers.py.
"""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.chat.client import Policy, Trouble, pause_s
from ssp_core.chat.completion import BrokenOff, Completion, NoCompletion, read_completion
from ssp_core.chat.errors import looks_like_html
from ssp_core.credentials import check_key, gives_away, redact, without_userinfo
from ssp_core.errors import InputError
from ssp_core.files.strict_json import parse_strict

KEY = 'sk-4f/9a"7<b>+2&d8'

# Patience.

BUSY = Trouble("429", "busy", safe=True)
LOST = Trouble("lost", "silent", lost=True)
FINAL = Trouble("400", "no")


@pytest.mark.parametrize(
    ("trouble", "tries", "left_s", "expected_s"),
    [
        (BUSY, 1, None, 1.0),
        (BUSY, 2, None, 2.0),
        (BUSY, 3, None, 4.0),
        (BUSY, 4, None, None),
        (BUSY, 1, 1.001, 1.0),
        (BUSY, 1, 1.0, None),
        (BUSY, 1, -1.0, None),
        (Trouble("429", "busy", safe=True, wait_s=7.0), 3, None, 7.0),
        (Trouble("429", "busy", safe=True, wait_s=60.0), 1, None, 60.0),
        (Trouble("429", "busy", safe=True, wait_s=60.1), 1, None, None),
        (Trouble("429", "busy", safe=True, wait_s=0.0), 1, 0.1, 0.0),
        (Trouble("429", "busy", safe=True, wait_s=7.0), 1, 7.0, None),
        (Trouble("400", "no", wait_s=1.0), 1, None, None),
        (LOST, 1, None, None),
        (FINAL, 1, None, None),
    ],
)
def test_what_is_tried_again_and_when(trouble, tries, left_s, expected_s):
    assert pause_s(Policy(tries=4), trouble, tries, left_s) == expected_s


def test_a_policy_may_ask_again_for_what_was_lost():
    policy = Policy(retry_lost=True)
    assert pause_s(policy, LOST, 1, None) == 1.0
    assert pause_s(policy, FINAL, 1, None) is None


def test_a_wait_has_an_end_however_many_tries_there_are():
    assert pause_s(Policy(tries=10_000), BUSY, 5000, None) == 60.0


def test_the_library_is_imported_by_those_who_ask_only():
    code = (
        "import sys, ssp_core.chat.client, ssp_core.cli\n"
        "import ssp_vla_bridge.backend, ssp_vla_bridge.prompts\n"
        "assert not [m for m in ('openai', 'httpx2', 'aiohttp') if m in sys.modules]\n"
        "ssp_core.chat.client.OpenAIChat('http://127.0.0.1:9/v1', 'm')\n"
        "assert 'openai' in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


# Keys.


@pytest.mark.parametrize(
    "shape",
    [
        lambda key: f"bad key {key}.",
        lambda key: json.dumps({"error": f"Bearer {key}"}),
        lambda key: json.dumps({"error": key}).replace("/", "\\/"),
        lambda key: f"{key}{key} {key}",
        lambda key: f"you sent {key[:11]}",
        lambda key: f"…{key[-9:]} is wrong",
        lambda key: "?key=sk-4f%2F9a%227%3Cb%3E%2B2%26d8",
        lambda key: "<p>sk-4f/9a&quot;7&lt;b&gt;+2&amp;d8</p>",
    ],
)
def test_a_key_is_taken_out_in_all_its_forms(shape):
    shown = redact(shape(KEY), KEY)
    assert "[key]" in shown
    assert "4f" not in shown
    assert "d8" not in shown


@given(st.text(), st.text(), st.text(alphabet="abcXYZ019-_", min_size=8, max_size=30))
def test_no_text_around_a_key_shows_it(before, after, key):
    shown = redact(before + key + after, key)
    assert key not in shown.replace("[key]", "\n")
    other = "".join(character for character in before + after if character not in key)
    assert redact(other, key) == other


@pytest.mark.parametrize(
    ("key", "text", "shown"),
    [
        (None, "all of it", "all of it"),
        ("", "all of it", "all of it"),
        ("EMPTY", "is EMPTY here", "is [key] here"),
        ("abcdefgh-secret", "bcdefg only", "bcdefg only"),
        ("abcdefgh-secret", "an abcdefgh here", "an [key] here"),
    ],
)
def test_what_is_and_what_is_not_taken_out(key, text, shown):
    assert redact(text, key) == shown


@pytest.mark.parametrize(
    ("body", "key", "given_away"),
    [
        (b"you sent abcdefgh", "abcdefgh", True),
        (b"you sent abcdefg", "abcdefgh", False),
        (b"EMPTY", "EMPTY", False),
        (b"anything", None, False),
        (b'{"k": "sk-4f\\/9a\\"7<b>+2&d8"}', KEY, True),
        (b"\xff\xfe abcdefgh", "abcdefgh", True),
        (b'{"k": "sk-4f/9a\\u00227\\u003Cb\\u003e\\u002b2\\u0026d8"}', KEY, True),
        ("".join(f"\\u{ord(c):04x}" for c in KEY).encode(), KEY, True),
        (b"\\u0061bcdefg", "abcdefgh", False),
    ],
)
def test_a_body_gives_a_key_away(body, key, given_away):
    assert gives_away(body, key) is given_away


def test_a_key_is_checked_before_it_is_sent():
    assert check_key("K", " abc\r\n", "or not") == "abc"
    with pytest.raises(InputError, match="the environment has no K, or it is empty; export it, or"):
        check_key("K", None, "leave it")
    with pytest.raises(InputError, match="holds a blank") as refused:
        check_key("K", "abc def", "leave it")
    assert "abc" not in str(refused.value)


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("http://me:pw@host:8/v1", "http://host:8/v1"),
        ("https://host/v1", "https://host/v1"),
        ("http://[::1", "the address"),
    ],
)
def test_an_address_is_shown_without_its_password(url, shown):
    assert without_userinfo(url) == shown


# Replies.


def reply(message, **more):
    return json.dumps({"choices": [{"message": message, "finish_reason": "stop"}], **more}).encode()


def test_a_plain_reply():
    usage = {"prompt_tokens": 5, "completion_tokens": 2, "total_tokens": 7, "more": {"x": 1}}
    body = reply({"content": "Hi."}, model="m-1", system_fingerprint="fp", usage=usage)
    assert read_completion(body) == Completion(
        text="Hi.",
        finish_reason="stop",
        model="m-1",
        system_fingerprint="fp",
        usage={"prompt_tokens": 5, "completion_tokens": 2, "total_tokens": 7},
    )
    assert not read_completion(body).cut_off


@pytest.mark.parametrize(
    ("body", "page"),
    [
        (b"\xef\xbb\xbf\n <!DOCTYPE HTML>", True),
        (b"<html lang=en>", True),
        (b"<?xml version='1.0'?>", True),
        (b'{"choices": "<html>"}', False),
        (b"", False),
    ],
)
def test_a_page_is_told_from_json(body, page):
    assert looks_like_html(body) is page


FILTERS = [
    {"code": "content_filter", "message": "held back"},
    {"code": "content_policy_violation", "message": "Rejected as a result of our safety system."},
    {"code": "moderation_blocked", "type": "user_error"},
    {"code": "DataInspectionFailed", "message": "Input data may contain inappropriate content."},
    {"code": 403, "message": "It requires moderation. Your input was flagged for 'violence'."},
    {"code": 400, "message": "The prompt triggered the content management policy. Please retry."},
    {"code": "invalid_prompt", "message": "It goes against our usage policy."},
    {"type": "invalid_request_error", "message": "Output blocked by content filtering policy"},
    {"code": 400, "innererror": {"code": "ResponsibleAIPolicyViolation"}},
    {
        "code": 400,
        "message": "Provider returned error",
        "metadata": {"raw": '{"error": {"code": "content_filter"}}'},
    },
    "the request did not pass moderation",
]
OUTAGES = [
    {"code": 503, "message": "moderation service temporarily unavailable"},
    {"code": "503", "message": "blocked by moderation"},
    {"code": 502, "message": "Connection reset", "metadata": {"content_filter_results": {}}},
    {"code": 400, "message": "upstream", "metadata": {"raw": "no worker", "moderation": None}},
    {"code": 429, "message": "rejected: rate; see the usage policy"},
    {"message": "moderation quota used up, retry later"},
    {"message": "the moderation service is down"},
    {"code": "content_filter_error", "message": "no verdict"},
    {
        "code": 400,
        "metadata": {"raw": '{"error": {"code": 529, "message": "blocked by policy"}}'},
    },
]


@pytest.mark.parametrize("error", FILTERS)
@pytest.mark.parametrize("held", ["reply", "choice", "message"])
def test_a_filters_refusal_is_final(error, held):
    said = read_completion(with_error(error, held))
    assert said.text is None
    assert said.refusal.startswith("filtered by the server: ")


@pytest.mark.parametrize("error", OUTAGES)
@pytest.mark.parametrize("held", ["reply", "choice", "message"])
def test_an_outage_is_no_refusal_whatever_it_names(error, held):
    with pytest.raises(BrokenOff, match="says: "):
        read_completion(with_error(error, held))


def with_error(error, held):
    """Return a reply that holds the error in the place of choices or beside its text."""
    if held == "reply":
        return json.dumps({"error": error}).encode()
    choice = {"message": {"content": "I brake."}, "finish_reason": "stop"}
    (choice if held == "choice" else choice["message"])["error"] = error
    return json.dumps({"choices": [choice]}).encode()


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        ({"code": 429, "message": "flagged by us"}, "flagged by us"),
        ({"error": "flagged by us", "code": 503}, "flagged by us"),
        ({"detail": [{"msg": "no worker", "type": "moderation_timeout"}]}, "no worker"),
        ({"errors": ["no worker"]}, "no worker"),
        ({"error": {"code": 7}}, "7"),
    ],
)
def test_an_error_may_stand_in_the_reply_itself(value, shown):
    with pytest.raises(BrokenOff, match=f"^it says: {shown}$"):
        read_completion(json.dumps(value).encode())


TEXT = "A car ahead. I brake. Trajectory: [[4, 0], [7,"


def ended(choice, beside):
    """Read a reply with a text, and what else its choice and the reply say."""
    choice = {"message": {"content": TEXT}, **choice}
    return read_completion(json.dumps({"choices": [choice], **beside}).encode())


@pytest.mark.parametrize(
    ("choice", "beside", "shown"),
    [
        ({"finish_reason": "stop"}, {"errors": [{"message": "CUDA error"}]}, "it says: CUDA error"),
        ({"finish_reason": "stop"}, {"errors": ["CUDA error"]}, "it says: CUDA error"),
        ({"finish_reason": "stop", "errors": ["lost"]}, {}, "its choice says: lost"),
        ({"finish_reason": "stop"}, {"error_code": 7, "error_msg": "lost"}, "it says: lost"),
        (
            {"finish_reason": "stop", "native_finish_reason": "error"},
            {},
            "broke the answer off (native_finish_reason error)",
        ),
        ({"finish_reason": "length"}, {"status": "failed"}, "(status failed)"),
        ({"finish_reason": "content_filter"}, {"done_reason": "abort"}, "(done_reason abort)"),
        ({"finish_reason": "stop"}, {"done": False}, "(done false)"),
        ({"finish_reason": {"type": "abort"}}, {}, "(finish_reason abort)"),
    ],
)
def test_an_error_or_a_broken_end_beside_the_choice_is_no_answer(choice, beside, shown):
    with pytest.raises(BrokenOff) as broken:
        ended(choice, beside)
    assert shown in str(broken.value)


@pytest.mark.parametrize(
    ("choice", "beside"),
    [
        ({"finish_reason": "stop", "native_finish_reason": "MAX_TOKENS"}, {}),
        ({"finish_reason": "stop", "stop_reason": "max_tokens"}, {}),
        ({"finish_reason": ["length"]}, {}),
        ({}, {"done": True, "done_reason": "length"}),
        ({}, {"stop_reason": "max_tokens"}),
        ({"finish_reason": "stop"}, {"stop_type": "limit"}),
        ({"finish_reason": "stop"}, {"truncated": True}),
        ({"finish_reason": "stop"}, {"status": "incomplete"}),
        ({"finish_reason": "stop"}, {"incomplete_details": {"reason": "max_output_tokens"}}),
    ],
)
def test_a_limit_beside_the_choice_cuts_the_answer(choice, beside):
    said = ended(choice, beside)
    assert said.cut_off
    assert (said.text, said.refusal) == (TEXT, None)


@pytest.mark.parametrize(
    ("choice", "beside"),
    [
        ({"finish_reason": "stop", "native_finish_reason": "SAFETY"}, {}),
        ({"finish_reason": "stop", "content_filter_results": {"hate": {"filtered": True}}}, {}),
        (
            {"finish_reason": "length"},
            {"status": "incomplete", "incomplete_details": {"reason": "content_filter"}},
        ),
    ],
)
def test_a_filter_beside_the_choice_is_a_refusal(choice, beside):
    assert ended(choice, beside).refusal.startswith("filtered by the server (")


SOUND = {"violence": {"filtered": False, "severity": "safe"}, "error": {"code": "x"}}


@pytest.mark.parametrize(
    ("choice", "beside", "reason"),
    [
        ({}, {}, None),
        ({"finish_reason": "stop", "native_finish_reason": "shift_change"}, {}, "stop"),
        ({"finish_reason": "stop", "stop_reason": "Policy:"}, {}, "stop"),
        ({"finish_reason": "stop", "stop_reason": 151645}, {}, "stop"),
        ({"finish_reason": "shift_change"}, {"stop_reason": "end_turn"}, "shift_change"),
        ({"finish_reason": "stop", "content_filter_results": SOUND}, {}, "stop"),
        ({"finish_reason": "stop"}, {"status": "completed", "incomplete_details": None}, "stop"),
        ({"finish_reason": "stop"}, {"status": 200, "truncated": False, "done": True}, "stop"),
        ({"finish_reason": "stop"}, {"stop_type": "word", "status": "ready"}, "stop"),
        ({"finish_reason": "stop"}, {"error": {}, "errors": [], "error_code": 0}, "stop"),
        ({"finish_reason": "stop", "error": None}, {"errors": None, "message": "ok"}, "stop"),
    ],
)
def test_what_stands_beside_a_whole_answer_leaves_it_whole(choice, beside, reason):
    said = ended(choice, beside)
    assert (said.text, said.finish_reason) == (TEXT, reason)
    assert (said.cut_off, said.refusal) == (False, None)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                [
                    "choices",
                    "message",
                    "content",
                    "type",
                    "text",
                    "refusal",
                    "finish_reason",
                    "status",
                    "content_filter_results",
                    "usage",
                    "model",
                    "error",
                    "errors",
                    "code",
                    "detail",
                    "total_tokens",
                    "reasoning_content",
                ]
            ),
            inner,
            max_size=4,
        )
    ),
    max_leaves=20,
)


@given(json_values | st.builds(lambda m: {"choices": [{"message": m}]}, json_values))
def test_any_json_is_a_completion_or_says_why_not(value):
    try:
        said = read_completion(json.dumps(value).encode())
    except NoCompletion:
        return
    assert said.text is None or said.text.encode()
    assert all(isinstance(count, int) for count in (said.usage or {}).values())


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('{"a": NaN}', "NaN is no number"),
        ('{"a": -Infinity}', "-Infinity is no number"),
        ('{"a": 1, "a": 1}', "key 'a' stands twice"),
        ("[" * 200_000, "nested too deeply"),
        (b"\xff", r"not UTF-8 \(byte 0\)"),
        ("{} {}", "Extra data"),
        ("1" * 5000, "digits"),
        ("", "Expecting value"),
    ],
)
def test_strict_json_raises_one_kind_of_error(text, what):
    with pytest.raises(ValueError, match=what):
        parse_strict(text)


@given(json_values.filter(lambda value: "NaN" not in json.dumps(value)))
def test_strict_json_reads_what_json_is(value):
    text = json.dumps(value)
    if "Infinity" not in text:
        assert parse_strict(text) == parse_strict(text.encode()) == value
