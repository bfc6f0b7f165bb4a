"""The answer in a model's output, and the reason why the answer ended (METHOD 5.4b)."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.chat.answer_text import Ending, ending, plain_width, split_answer


@pytest.mark.parametrize(
    ("output", "text"),
    [
        ("I slow down.", "I slow down."),
        ("<think>a bus</think>\nI slow down.", "I slow down."),
        ("[THINK]a bus[/THINK]I slow down.", "I slow down."),
        ("<seed:think>a bus</seed:think>I slow down.", "I slow down."),
        ("◁think▷a bus◁/think▷I slow down.", "I slow down."),
        ("a bus</think>I slow down.", "I slow down."),
        ("<think>a bus", ""),
        (
            "<|channel|>analysis<|message|>a bus<|end|><|start|>assistant"
            "<|channel|>final<|message|>I slow down.<|return|>",
            "I slow down.",
        ),
        ("<|channel>thought\na bus<channel|>I slow down.<turn|>", "I slow down."),
        ("<|think|>a bus<|end|><|begin|>assistant<|content|>I slow down.<|end|>", "I slow down."),
        ("<longcat_think>a bus</longcat_think>I slow down.", "I slow down."),
        ("&lt;think&gt;a bus&lt;/think&gt;I slow down.", "I slow down."),
        ("＜think＞a bus＜/think＞I slow down.", "I slow down."),
        ("Here is my thought process:\na bus\nHere is my response:\nI stop.", "I stop."),
        ("Here is my response:\nI stop.", "Here is my response:\nI stop."),
        ("Here are my reasoning steps:\na bus\n[BEGIN FINAL RESPONSE]\nI stop.", "I stop."),
        ("analysisA bus.assistantfinalI slow down.", "I slow down."),
        ("Analysis: a bus. I slow down.", "Analysis: a bus. I slow down."),
        ("I slow down.<turn|>\n<|turn>user\nAnd then?", "I slow down."),
        ("I slow down.<｜end▁of▁sentence｜>I stop.", "I slow down."),
        ("I slow down.<|header_start|>user<|header_end|>And then?", "I slow down."),
        ("I slow down.\nuser\nAnd then?\nassistant\nI stop.", "I slow down."),
        ("I slow down.assistant\n\nI stop.", "I slow down."),
        ("I slow down.\n### Human\nAnd then?", "I slow down."),
        ("As your assistant I slow down.", "As your assistant I slow down."),
        ("I slow down.<|im_end|>\n<|im_start|>user\nAnd then?", "I slow down."),
        ("<|im_start|>assistant\nI slow down.<|im_end|>", "I slow down."),
        ("Assistant: I slow down.\n\nHuman: And then?", "I slow down."),
        ("I slow down.\n**User:** And then?", "I slow down."),
        ("<chain-of-thought>a bus</chain-of-thought>I slow down.", "I slow down."),
        ("<scratch-pad>a bus</scratch-pad>I slow down.", "I slow down."),
        ("<innerMonologue>a bus</innerMonologue>I slow down.", "I slow down."),
        ("<thinking-process>a bus</thinking-process>I slow down.", "I slow down."),
        ("<reasoning_content>a bus</reasoning_content>I slow down.", "I slow down."),
        ("<deep_thinking>a bus</deep_thinking>I slow down.", "I slow down."),
        ("<antThinking>a bus</antThinking>I slow down.", "I slow down."),
        ("<think_never_used_51bce0c785ca>a bus</think_never_used_51bce0c785ca>I stop.", "I stop."),
        ("Thinking...\na bus\n...done thinking.\n\nI slow down.", "I slow down."),
        ("Thinking...\nI am done thinking. I slow down.",) * 2,
        ("<think />\nI slow down.",) * 2,
        ("<scene_analysis>a bus</scene_analysis> Stop.",) * 2,
        ("I slow down.\n[USER] And then?", "I slow down."),
        ("I slow down.\n<<SYS>> Answer in one line. <</SYS>>", "I slow down."),
        ("I slow down.\n[HUMAN] crosses ahead.",) * 2,
        ("I slow down.\nUser 2: I stop.", "I slow down."),
        ("I slow down.\nUSER (next): And then?", "I slow down."),
        ("I slow down.\nHuman 1: And then?", "I slow down."),
        ("I slow down.\n(User): And then?", "I slow down."),
        ("I slow down.\n<human> And then?", "I slow down."),
        ("I slow down.\n**Human**\nAnd then?", "I slow down."),
        ("I slow down.\nHuman - I accelerate.", "I slow down."),
        ('I slow down.\n{"role": "user", "content": "And?"}', "I slow down."),
        ("{think}a bus{/think}I slow down.", "I slow down."),
        ("**Assistant**\nI slow down.", "\nI slow down."),
        ("Assistant (final): I slow down.\n<user>And then?</user>", "I slow down."),
        ("Humans:\nHuman 1: now crosses.\nHuman (adult): stands.",) * 2,
        ("<objects>\n<human>one</human>\n</objects>",) * 2,
        ("System 2: I slow down.",) * 2,
        ("User interface: dark.\nHuman-driven: yes.",) * 2,
        # A road user's name is no speaker, and a heading in brackets is no mark of reasoning.
        ("Pedestrian: crosses.\nRoad user: one.", "Pedestrian: crosses.\nRoad user: one."),
        ("[Reasoning] A bus ahead. [Action] I stop.", "[Reasoning] A bus ahead. [Action] I stop."),
        ("I think that I slow down.", "I think that I slow down."),
    ],
)
def test_the_answer_is_what_stands_outside_of_reasoning_and_before_the_next_turn(output, text):
    assert split_answer(output).text == text


def test_what_was_left_out_is_noted():
    part = split_answer("<think>a bus</think>I stop.<|im_end|>\n<|im_start|>user\nAnd?")
    assert part.reasoning == "a bus"
    assert part.notes == (
        "reasoning was left out",
        "what follows the end of the own turn was left out",
    )
    assert split_answer("I stop.<|im_end|>").notes == ()


@pytest.mark.parametrize(
    ("reason", "wanted"),
    [
        (None, Ending.WHOLE),
        ("", Ending.WHOLE),
        ("stop", Ending.WHOLE),
        ("STOP", Ending.WHOLE),
        ("end_turn", Ending.WHOLE),
        ("length", Ending.LIMIT),
        ("MAX_TOKENS", Ending.LIMIT),
        ("maxTokens", Ending.LIMIT),
        ("model_length", Ending.LIMIT),
        ("abort", Ending.BROKEN),
        ("error", Ending.BROKEN),
        ("Cancelled", Ending.BROKEN),
        ("SAFETY", Ending.FILTERED),
        ("maxPredictedTokensReached", Ending.LIMIT),
        ("ERROR_LIMIT", Ending.LIMIT),
        ("FinishReason.MAX_TOKENS", Ending.LIMIT),
        ("contextFull", Ending.LIMIT),
        ("userStopped", Ending.BROKEN),
        ("time_limit", Ending.BROKEN),
        ("timed_out", Ending.BROKEN),
        ("upstream_error", Ending.BROKEN),
        ("not_finished", Ending.BROKEN),
        ("server_shutting_down", Ending.BROKEN),
        ("stream_closed", Ending.BROKEN),
        ("content_filter: SAFETY", Ending.FILTERED),
        ("ERROR_TOXIC", Ending.FILTERED),
        ("eosFound", Ending.WHOLE),
        ("null", Ending.WHOLE),
        ("tool_calls", Ending.UNKNOWN),
        ("content_filter", Ending.FILTERED),
        ("shift_change", Ending.UNKNOWN),
    ],
)
def test_reasons_are_read_in_any_spelling(reason, wanted):
    assert ending(reason) is wanted


@given(st.text(max_size=300))
def test_no_output_raises_and_full_width_keeps_its_places(output):
    part = split_answer(output)
    assert len(part.text) <= len(output)
    assert len(plain_width(output)) == len(output)


@pytest.mark.parametrize(
    "output", ["<s>" * 1_000_000 + "stop", "<|im_assistant|>" + " " * 60_000 + "stop"]
)
def test_a_long_opening_is_read_once(output):
    began = time.process_time()
    assert split_answer(output).text.strip() == "stop"
    assert time.process_time() - began < 8.0
