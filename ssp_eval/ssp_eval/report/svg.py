"""The little SVG that the figures need: elements as text, numbers short, text escaped."""

from __future__ import annotations

from html import escape


def number(value: float) -> str:
    """A coordinate with at most two decimals."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


def element(name: str, content: str = "", **attributes: float | str) -> str:
    """One element; ``class_`` is class, other underscores become hyphens.

    Args:
        name: tag.
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
    """A text element at its baseline."""
    return element("text", escape(content) or " ", x=x, y=y, **attributes)


def title(content: str) -> str:
    """What a pointer shows."""
    return element("title", escape(content))


def points(pairs: list[tuple[float, float]]) -> str:
    """The value of a ``points`` attribute."""
    return " ".join(f"{number(x)},{number(y)}" for x, y in pairs)
