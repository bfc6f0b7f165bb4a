"""XML as bytes that depend on nothing but its content."""

from __future__ import annotations

# The standard library's, which only builds and writes here: nothing is parsed.
import xml.etree.ElementTree as ET

# The standards ask for a date. A date of writing would make the same task give other bytes.
FIXED_DATE = "2000-01-01T00:00:00"


def to_bytes(root: ET.Element) -> bytes:
    """UTF-8 with a declaration, indented by two spaces, and a final newline."""
    ET.indent(root, "  ")
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()
