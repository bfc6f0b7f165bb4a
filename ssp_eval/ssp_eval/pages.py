"""The parts that all pages are made with: style, SVG elements, and pictures as data URIs."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path

import cv2
import numpy as np
from markupsafe import Markup

from ssp_core.errors import InputError, not_read


def style(*further: Path) -> Markup:
    """Return the style that all pages share, with what further sheets add to it."""
    sheets = Path(__file__).with_suffix(".css"), *further
    return Markup("".join(sheet.read_text("utf-8") for sheet in sheets))


def number(value: float) -> str:
    """Return a coordinate with at most two decimals."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


def element(name: str, content: str = "", **attributes: float | str) -> str:
    """Return one element; ``class_`` is class, other underscores become hyphens.

    Args:
        name: of the element.
        content: inner SVG, already escaped.
        attributes: numbers are shortened, strings escaped.
    """
    parts = [name]
    for key, value in attributes.items():
        text = value if isinstance(value, str) else number(value)
        parts.append(f'{key.rstrip("_").replace("_", "-")}="{escape(text)}"')
    head = " ".join(parts)
    return f"<{head}>{content}</{name}>" if content else f"<{head}/>"


def text(x: float, y: float, content: str, **attributes: float | str) -> str:
    """Return a text element at its baseline."""
    return element("text", escape(content) or " ", x=x, y=y, **attributes)


def title(content: str) -> str:
    """Make the text that a pointer shows."""
    return element("title", escape(content))


def points(pairs: list[tuple[float, float]]) -> str:
    """Return the value of a ``points`` attribute."""
    return " ".join(f"{number(x)},{number(y)}" for x, y in pairs)


MAX_WIDTH_PX = 640
_QUALITY = 72


def data_uri(path: Path) -> str:
    """Return a frame at most 640 px wide, as a data URI.

    Raises:
        InputError: it isn't there or is no picture.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise not_read(path, error) from error
    return jpeg_uri(data, path)


def jpeg_uri(data: bytes, place: str | Path, max_width_px: int = MAX_WIDTH_PX) -> str:
    """Make a data URI as data_uri does, from a picture's bytes.

    Raises:
        InputError: it is no picture.
    """
    pixels = np.frombuffer(data, np.uint8)
    image = cv2.imdecode(pixels, cv2.IMREAD_COLOR) if pixels.size else None
    if image is None:
        raise InputError("is no picture", file=place, remedy="put the picture back")
    height, width = image.shape[:2]
    if width > max_width_px:
        size = (max_width_px, max(1, round(height * max_width_px / width)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return "data:image/jpeg;base64," + base64.b64encode(encoded.tobytes()).decode()
