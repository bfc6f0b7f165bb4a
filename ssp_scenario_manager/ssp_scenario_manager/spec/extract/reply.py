"""The text in a server's reply, or why there is none."""

from __future__ import annotations

from ssp_core.chat import NoCompletion, read_completion
from ssp_core.errors import PeerError
from ssp_scenario_manager.spec.extract.answers import BadAnswer, printable


def reply_text(body: bytes, where: str) -> str:
    """What the model wrote.

    Args:
        body: of a chat completion.
        where: file in which the body stands, for messages.

    Raises:
        PeerError: it is no chat completion, or the model declined to answer.
        BadAnswer: the answer was cut off, or is empty; another try may help.
    """
    try:
        said = read_completion(body)
    except NoCompletion as error:
        raise PeerError(
            f"the server's reply is no chat completion: {printable(str(error))} (kept in {where}); "
            "--base-url usually ends in /v1"
        ) from error
    if said.refusal:
        raise PeerError(
            f"the model declines to answer: {printable(said.refusal)[:200]} (kept in {where}); "
            "another model may answer, or write the event by hand"
        )
    if said.cut_off:
        raise BadAnswer(["the answer was cut off at the limit of its length"])
    if not said.text or not said.text.strip():
        raise BadAnswer(["the answer is empty"])
    return said.text
