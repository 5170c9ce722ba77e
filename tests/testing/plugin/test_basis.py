"""The summary, the report and each JUnit case of a session say what their verdicts rest on."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.basis import rests_on


def test_a_session_says_what_its_verdicts_rest_on(
    project: Path, run: Callable[..., pytest.RunResult]
) -> None:
    words = ("--safety-world", "kinematic", "--junitxml=junit.xml", "--safety-report=r.html")
    found = run("fine.yaml", *words)
    world = "the kinematic world"
    assert rests_on(found.stdout.str(), world)
    assert rests_on((project / "r.html").read_text(), world)
    cases = list(ET.parse(project / "junit.xml").iter("testcase"))
    assert cases
    for case in cases:
        said = {one.get("name", ""): one.get("value", "") for one in case.iter("property")}
        claims = [name for name in said if name.startswith("claim")]
        assert claims
        assert all(rests_on(said[name.replace("claim", "basis")], world) for name in claims)
        assert "exercised in 1 of 1 runs" in said["basis"]
