"""JUnit XML of runs: valid by the schema that build servers use, failures and errors apart."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lxml import etree

from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.run.junit import Case, junit_xml, write_junit
from ssp_scenario_manager.session.run_script import RunOutcome

# The elements, attributes and orders that build servers agree on.
SCHEMA = etree.XMLSchema(
    etree.fromstring(
        b"""<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema">
  <xs:complexType name="told">
    <xs:simpleContent><xs:extension base="xs:string">
      <xs:attribute name="type" type="xs:string" use="required"/>
      <xs:attribute name="message" type="xs:string"/>
    </xs:extension></xs:simpleContent>
  </xs:complexType>
  <xs:complexType name="properties"><xs:sequence>
    <xs:element name="property" maxOccurs="unbounded"><xs:complexType>
      <xs:attribute name="name" type="xs:string" use="required"/>
      <xs:attribute name="value" type="xs:string" use="required"/>
    </xs:complexType></xs:element>
  </xs:sequence></xs:complexType>
  <xs:attributeGroup name="counts">
    <xs:attribute name="name" type="xs:string" use="required"/>
    <xs:attribute name="tests" type="xs:nonNegativeInteger" use="required"/>
    <xs:attribute name="failures" type="xs:nonNegativeInteger" use="required"/>
    <xs:attribute name="errors" type="xs:nonNegativeInteger" use="required"/>
    <xs:attribute name="time" type="xs:decimal" use="required"/>
  </xs:attributeGroup>
  <xs:element name="testsuites"><xs:complexType>
    <xs:sequence><xs:element name="testsuite" maxOccurs="unbounded"><xs:complexType>
      <xs:sequence><xs:element name="testcase" minOccurs="0" maxOccurs="unbounded">
        <xs:complexType>
          <xs:sequence>
            <xs:element name="properties" type="properties" minOccurs="0"/>
            <xs:choice minOccurs="0">
              <xs:element name="failure" type="told"/>
              <xs:element name="error" type="told"/>
            </xs:choice>
          </xs:sequence>
          <xs:attribute name="classname" type="xs:string" use="required"/>
          <xs:attribute name="name" type="xs:string" use="required"/>
          <xs:attribute name="time" type="xs:decimal" use="required"/>
        </xs:complexType>
      </xs:element></xs:sequence>
      <xs:attributeGroup ref="counts"/>
    </xs:complexType></xs:element></xs:sequence>
    <xs:attributeGroup ref="counts"/>
  </xs:complexType></xs:element>
</xs:schema>"""
    )
)


def case(verdict: Verdict, *reasons: str) -> Case:
    return Case("cut_in.boulevard", "run-1", RunOutcome(verdict, reasons), 3.25, {"seed": "7"})


def parsed(*cases: Case) -> etree._Element:
    tree = etree.fromstring(junit_xml("ssp run", cases).encode())
    SCHEMA.assertValid(tree)
    return tree


def test_a_valid_run() -> None:
    tree = parsed(case(Verdict.VALID))
    assert dict(tree.find("testsuite").attrib) == {
        "name": "ssp run",
        "tests": "1",
        "failures": "0",
        "errors": "0",
        "time": "3.250",
    }
    (run,) = tree.iter("testcase")
    assert dict(run.attrib) == {"classname": "cut_in.boulevard", "name": "run-1", "time": "3.250"}
    assert [(p.get("name"), p.get("value")) for p in run.iter("property")] == [("seed", "7")]
    assert run.find("failure") is run.find("error") is None


@pytest.mark.parametrize(
    ("verdict", "element"),
    [
        (Verdict.FAILED_SAFETY, "failure"),
        (Verdict.ABORTED, "failure"),
        (Verdict.OFF_SPEC, "failure"),
        (Verdict.INVALID_HARNESS, "error"),
        (Verdict.NONE, "error"),
    ],
)
def test_failures_and_errors(verdict: Verdict, element: str) -> None:
    tree = parsed(case(verdict, "separation: 0.3 m at 9.02 s", "second at 9.5 s"))
    (run,) = tree.iter("testcase")
    told = run.find(element)
    assert (told.get("type"), told.get("message")) == (
        verdict.name.lower(),
        "separation: 0.3 m at 9.02 s",
    )
    assert told.text == "separation: 0.3 m at 9.02 s\nsecond at 9.5 s"
    assert run.find("error" if element == "failure" else "failure") is None
    assert tree.get(f"{element}s") == "1"


def test_the_message_is_one_line() -> None:
    tree = parsed(case(Verdict.INVALID_HARNESS, "sil_world was killed; its last lines:\na\nb"))
    told = next(tree.iter("error"))
    assert told.get("message") == "sil_world was killed; its last lines:"
    assert (told.text or "").endswith("lines:\na\nb")


def test_several_runs_are_counted() -> None:
    tree = parsed(*(case(verdict, "why") for verdict in Verdict))
    assert [tree.get(k) for k in ("tests", "failures", "errors", "time")] == [
        "6",
        "3",
        "2",
        "19.500",
    ]


@given(st.text(), st.text())
def test_whatever_a_reason_holds_the_file_can_be_read(reason: str, name: str) -> None:
    """Last lines of logs hold escapes, control characters and halves of characters."""
    run = Case(name, name, RunOutcome(Verdict.ABORTED, (reason,)), 0.0, {name: reason})
    tree = etree.fromstring(junit_xml(name, [run]).encode())
    SCHEMA.assertValid(tree)


def test_it_is_written(tmp_path: Path) -> None:
    write_junit(tmp_path / "deep" / "junit.xml", "ssp run", [case(Verdict.ABORTED)])
    tree = etree.parse(tmp_path / "deep" / "junit.xml")
    assert next(tree.iter("failure")).get("message") == "no reason was given"
