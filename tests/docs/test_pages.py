"""What the pages of the site show of Python works, and the site finds what it would fetch from elsewhere."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import architecture_picture
import numpy as np
import pytest
import tables
from test_architecture import CORE, WINGS

from safety_harness import Trace, Verdict

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
LINK = re.compile(r"\]\(([^)#\s:]+)(?:#[^)\s]*)?\)")


@pytest.fixture
def keeps_clear() -> Any:
    (code,) = re.findall(r"```python\n(.*?)```", (DOCS / "how-to" / "claims.md").read_text(), re.DOTALL)
    namespace: dict[str, Any] = {"__name__": "page"}
    exec(compile(code, "claims.md", "exec", dont_inherit=True), namespace)
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
    "cell/simulation/slow_world.py",
    "claims/properties/NAME.py",
    "claims/properties/decision_count.py",
    "cli/count.py",
    "extensions/assurance/statistics/mean_margin.py",
    "extensions/height/commands.py",
    "scenarios/robot-ur5_joint_limited.yaml",
    "tests/assurance/statistics/test_mean_margin.py",
}


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/explanation/architecture.md"])
def test_every_file_that_a_developer_is_sent_to_is_there(page: str) -> None:
    named = set(re.findall(r"`((?:\w+/)+[\w-]+\.(?:py|json|yaml|j2))", (ROOT / page).read_text()))
    assert len(named) > 10
    for file in named - MADE_BY_A_RECIPE:
        assert (ROOT / file).is_file() or (ROOT / "safety_harness" / file).is_file(), file


ARCHITECTURE = (DOCS / "explanation" / "architecture.md").read_text()


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/explanation/architecture.md"])
def test_every_name_that_a_developer_is_sent_to_stands_in_its_file(page: str) -> None:
    named = re.findall(r"`([\w/]+\.py)`, `(\w+)`", (ROOT / page).read_text())
    assert len(named) > 10
    for file, name in named:
        (path,) = (one for one in (ROOT / "safety_harness" / file, ROOT / file) if one.is_file())
        assert re.search(rf"^(?:def |class )?{name}\b", path.read_text(), re.MULTILINE), (file, name)


def test_the_page_and_the_picture_have_the_packages_of_the_rule() -> None:
    rings = ARCHITECTURE.partition("## Rings")[2].partition("## How")[0]
    rows = [line.strip("| ").split(" | ") for line in rings.splitlines() if line.startswith("| `")]
    named = {row[0].strip("`"): row for row in rows}
    assert tuple(named)[: len(CORE)] == tuple(architecture_picture.CORE) == CORE
    assert {*named} - {*CORE} == {*architecture_picture.WINGS} == {*WINGS}
    for wing, others in WINGS.items():
        assert tuple(re.findall(r"`(\w+)`", " ".join(named[wing][3:]))) == others


@pytest.mark.parametrize(
    "page",
    [one for one in sorted(DOCS.rglob("*.md")) if "<!-- table: " in one.read_text()],
    ids=lambda one: one.name,
)
def test_a_page_has_the_tables_that_the_code_gives(page: Path) -> None:
    """If not: python docs/tables.py."""
    assert tables.with_tables(page.read_text(), page) == page.read_text()


def test_the_picture_is_as_the_code_has_it() -> None:
    """If not: python docs/tables.py."""
    assert architecture_picture.picture() == (DOCS / "assets" / "architecture.svg").read_text()


def test_an_arrow_of_the_picture_is_left_out_only_if_others_lead_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert (drawn := architecture_picture.picture().count('<path d="M')) > len(CORE)
    graph = architecture_picture.imports()
    graph["gym"] -= {one for one in graph["gym"] if one != "base"}
    monkeypatch.setattr(architecture_picture, "imports", lambda: graph)
    assert architecture_picture.picture().count('<path d="M') == drawn  # gym to base in place of admission
    graph["gym"].clear()
    assert architecture_picture.picture().count('<path d="M') == drawn - 1
