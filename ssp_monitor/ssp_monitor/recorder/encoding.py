"""Encodes a topic's pictures while they are written, and keeps what can't be encoded as it came."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ssp_core.bag.types import BagMessage
from ssp_core.errors import InputError
from ssp_monitor.recorder.topics import Pattern

if TYPE_CHECKING:
    from ssp_monitor.recorder.video_encoder import VideoEncoder

# Where pictures go that the encoder refused: beside the video, under the type that they have.
ORIGINAL = "/original"
PICTURES = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")
CODECS = ("h264", "h265")


@dataclass(frozen=True, slots=True)
class VideoChoice:
    """The topics of pictures that become video.

    Args:
        codec: one of CODECS.
        topics: found in the topic's name.
    """

    codec: str
    topics: Pattern

    def encoder(self, topic: str, msgtype: str) -> VideoEncoder | None:
        """Return an encoder for a topic, None when it is recorded as it comes."""
        if msgtype not in PICTURES or not self.topics.occurs_in(topic):
            return None
        # Codecs are large: who records no video doesn't load them.
        from ssp_monitor.recorder.video_encoder import VideoEncoder

        return VideoEncoder(msgtype, self.codec)


def video_choice(codec: str, topics: str) -> VideoChoice | None:
    """Make the choice out of two options; an empty codec is none.

    Raises:
        InputError: the codec or the expression isn't one.
    """
    if not codec:
        return None
    if codec not in CODECS:
        raise InputError(
            "is no codec", field="video", value=codec, remedy=f"{' or '.join(CODECS)}, or nothing"
        )
    return VideoChoice(codec, Pattern(topics, "video_topics"))


class Encoding:
    """One topic on its way through its encoder. Used by the writer thread alone.

    Args:
        add_original: announces a topic for what can't be encoded and returns its name; called at
            most once.
    """

    def __init__(self, encoder: VideoEncoder, add_original: Callable[[], str]) -> None:
        self._encoder = encoder
        self._add_original = add_original
        self.originals: str | None = None
        self.failed = 0
        self.problem = ""

    def encode(self, message: BagMessage) -> list[BagMessage]:
        """Encode a message; a failure never loses it."""
        try:
            return self._encoder.encode(message)
        except ValueError as error:
            self.problem = str(error)
        except Exception as error:
            # Codecs are foreign code: whatever they raise must not cost the picture.
            self.problem = f"{type(error).__name__}: {error}"
        self.failed += 1
        if self.originals is None:
            self.originals = self._add_original()
        return [message._replace(topic=self.originals)]

    def finish(self) -> list[BagMessage]:
        """Return the messages that the encoder held back."""
        try:
            return self._encoder.finish()
        except Exception as error:
            self.failed += 1
            self.problem = f"{type(error).__name__}: {error}"
            return []
