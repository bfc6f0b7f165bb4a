"""Runs as JUnit XML, which build servers read: what failed and what went wrong are kept apart.

A run that failed on safety, was aborted, or whose event didn't become that of K* (``off_spec``) is
a failure: the test said no. A run that our own side spoiled, or that has no verdict, is an error:
the test said nothing.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from ssp_core.files.writing import write_text
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.session.run_script import RunOutcome

_FAILURES = (Verdict.FAILED_SAFETY, Verdict.ABORTED, Verdict.OFF_SPEC)
# What XML 1.0 can't hold, escaped or not; last lines of logs are full of colours.
_NO_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True)
class Case:
    """One run.

    Args:
        group: of what: scenario and site, with a dot in between.
        name: of the run.
        outcome: its verdict, and the reasons with their times.
        wall_s: how long it took.
        properties: further facts by name.
    """

    group: str
    name: str
    outcome: RunOutcome
    wall_s: float
    properties: Mapping[str, str] = field(default_factory=dict)

    @property
    def result(self) -> str | None:
        """failure, error, or None for a valid run."""
        if self.outcome.ok:
            return None
        return "failure" if self.outcome.verdict in _FAILURES else "error"


def junit_xml(suite: str, cases: Sequence[Case]) -> str:
    """Write one test suite with a test case per run."""
    counts = {
        "tests": str(len(cases)),
        "failures": str(sum(case.result == "failure" for case in cases)),
        "errors": str(sum(case.result == "error" for case in cases)),
        "time": f"{sum(case.wall_s for case in cases):.3f}",
    }
    root = ElementTree.Element("testsuites", {"name": "ssp", **counts})
    element = ElementTree.SubElement(root, "testsuite", {"name": _text(suite), **counts})
    for case in cases:
        _add(element, case)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, "unicode") + "\n"


def write_junit(file: Path, suite: str, cases: Sequence[Case]) -> None:
    """Write the file; arguments as for junit_xml.

    Raises:
        InputError: it can't be written.
    """
    write_text(file, junit_xml(suite, cases))


def _add(suite: ElementTree.Element, case: Case) -> None:
    attributes = {
        "classname": _text(case.group),
        "name": _text(case.name),
        "time": f"{case.wall_s:.3f}",
    }
    element = ElementTree.SubElement(suite, "testcase", attributes)
    if case.properties:
        properties = ElementTree.SubElement(element, "properties")
        for name, value in case.properties.items():
            pair = {"name": _text(name), "value": _text(value)}
            ElementTree.SubElement(properties, "property", pair)
    if case.result is not None:
        reasons = case.outcome.reasons
        outcome_element = ElementTree.SubElement(
            element,
            case.result,
            {
                "type": case.outcome.verdict.name.lower(),
                # The first line: what a dead process logged last belongs below.
                "message": _text(next(iter(reasons), "no reason was given").partition("\n")[0]),
            },
        )
        outcome_element.text = _text("\n".join(reasons))


def _text(text: str) -> str:
    return _NO_XML.sub("\ufffd", text)
