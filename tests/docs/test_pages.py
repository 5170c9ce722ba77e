"""What the pages of the site show of Python works, and the site finds what it would fetch from elsewhere."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from safety_harness import Trace, Verdict

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
LINK = re.compile(r"\]\(([^)#\s:]+)(?:#[^)\s]*)?\)")


@pytest.fixture
def keeps_clear() -> Any:
    (code,) = re.findall(r"```python\n(.*?)```", (DOCS / "bring-your-own.md").read_text(), re.DOTALL)
    namespace: dict[str, Any] = {"__name__": "page"}
    exec(compile(code, "bring-your-own.md", "exec", dont_inherit=True), namespace)
    return namespace["KeepsClear"]


def test_the_property_of_the_page_holds_and_is_violated_by_its_limit(keeps_clear: Any, visit: Trace) -> None:
    nearest_m = visit.ticks["hand_distance_m"].min()
    for limit_m, verdict in ((nearest_m - 0.01, Verdict.HOLDS), (nearest_m + 0.01, Verdict.VIOLATED)):
        found = keeps_clear(limit_m).evaluate(visit)
        assert (found.verdict, found.margin) == (verdict, pytest.approx(nearest_m - limit_m))


def test_the_property_of_the_page_takes_no_nan_for_safe(keeps_clear: Any, visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["hand_distance_m"][3, 0] = np.nan
    assert keeps_clear().evaluate(dataclasses.replace(visit, ticks=ticks)).verdict is Verdict.INCONCLUSIVE


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda page: page.name)
def test_every_link_of_a_page_leads_to_something(page: Path) -> None:
    for link in LINK.findall(page.read_text()):
        assert (page.parent / link).exists(), link


def test_every_page_is_in_the_site_s_contents() -> None:
    contents = (ROOT / "mkdocs.yml").read_text()
    for page in DOCS.rglob("*.md"):
        assert f": {page.relative_to(DOCS)}" in contents, page


MADE_BY_A_RECIPE = {
    "properties/decision_count.py",
    "robot/ur5_joint_limited_capsules.json",
    "scenarios/robot-ur5_joint_limited.yaml",
    "simulation/slow_world.py",
}


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/architecture.md"])
def test_every_file_that_a_developer_is_sent_to_is_there(page: str) -> None:
    named = set(re.findall(r"`((?:\w+/)+[\w-]+\.(?:py|json|yaml|j2))", (ROOT / page).read_text()))
    assert len(named) > 10
    for file in named - MADE_BY_A_RECIPE - {"properties/NAME.py"}:
        assert (ROOT / file).is_file() or (ROOT / "safety_harness" / file).is_file(), file
