"""Every text of every page, drawing and XML file may be markup of a stranger's; it stays text everywhere."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from datetime import UTC, datetime
from enum import Enum
from html.parser import HTMLParser
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import factory
import made_up
import made_up_evidence
import made_up_faults
import pytest
import score_cards
import test_page as reproduction
import test_search_page as search

import safety_harness
import safety_harness_paper
from safety_harness.cell.robot.robots import arm_capsules, arm_model
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.extensions.arms import page as arm_page
from safety_harness.extensions.assurance.campaign.episodes import failed_row
from safety_harness.extensions.assurance.campaign.identity import Identity
from safety_harness.extensions.assurance.campaign.summary import state_of
from safety_harness.extensions.assurance.certification.delta import delta_between
from safety_harness.extensions.assurance.certification.delta_page import render as delta_page
from safety_harness.extensions.assurance.certification.folder import junit_xml
from safety_harness.extensions.assurance.certification.page import render as evidence_page
from safety_harness.extensions.assurance.pages.campaign_page import write_page as write_campaign
from safety_harness.extensions.assurance.pages.history import read_history
from safety_harness.extensions.assurance.pages.history import write_page as write_history
from safety_harness.extensions.lab.pages.proof_page import ProofEvidence
from safety_harness.extensions.lab.pages.proof_page import render as proof_page
from safety_harness.extensions.lab.pages.question_maps import VIEWS, question_map
from safety_harness.extensions.lab.pages.score_page import FAR, ScoreEvidence
from safety_harness.extensions.lab.pages.score_page import render as score_page
from safety_harness.extensions.lab.proof.certificate import Proof, WrongQuestion
from safety_harness.extensions.lab.proof.plan import read_proof_plan
from safety_harness.extensions.lab.proof.session import fresh
from safety_harness.extensions.lab.proof.together import joint_bounds
from safety_harness.extensions.lab.proof.tree import BoxTree
from safety_harness.extensions.pages.coverage_map import coverage_map
from safety_harness.extensions.pages.page_parts import asset
from safety_harness.extensions.pages.run_page import render as report_page
from safety_harness.extensions.pages.search_page import render as search_page
from safety_harness.extensions.pages.svg import standalone
from safety_harness.extensions.pages.view_page import write_view
from safety_harness.extensions.selftest.document import render as selftest_page
from safety_harness.report.machine import FORMAT
from safety_harness.scenario.robots import Robot
from safety_harness_paper import figure7, table1
from safety_harness_paper.page import render as reproduction_page
from safety_harness_paper.scale import DEFAULT
from tests.assurance.campaign.plans import ledger_in, plan_in
from tests.lab.proof.regions import PLAN, plan_file

MARKUP = "</script></style></svg><img src=x onerror=alert(1)><script>alert(2)</script>\"'&{{7*7}}"
IN_PLACE = {  # what is looked up, never shown as it came
    "format",
    "kind",
    "direction",
    "speed",
    "distance",
    "seen",
    "outcome",
    "symbol",
    "unit",
    "arm_name",
    "avoider_sha256",
    "rows",
}
WHEN = datetime(2026, 11, 21, tzinfo=UTC)


def spoilt(value: Any) -> Any:
    """The same with markup at the end of every text."""
    if isinstance(value, Enum):
        return value
    if isinstance(value, str):
        return value + MARKUP
    if isinstance(value, tuple | list):
        return type(value)(map(spoilt, value)) if type(value) in (tuple, list) else value
    if is_dataclass(value) and not isinstance(value, type):
        changes = {
            field.name: spoilt(getattr(value, field.name))
            for field in fields(value)
            if field.init and field.name not in IN_PLACE
        }
        return replace(value, **changes)
    return value


def report() -> str:
    runs = [spoilt(factory.violated_run()), spoilt(factory.truncated_run())]
    return report_page(runs, title=MARKUP, command=MARKUP, interrupted=True, generated_at=WHEN)


def a_search() -> str:
    return search_page(spoilt(search.evidence()))


def certified() -> str:
    return evidence_page(spoilt(made_up_evidence.evidence()), {1: spoilt(factory.violated_run())})


def tried() -> str:
    return selftest_page(spoilt(list(made_up_faults.EVERY_KIND)), spoilt(made_up_faults.about()))


def reproduced() -> str:
    results = [
        table1.result(DEFAULT, made_up.main_evaluations()),
        figure7.result(DEFAULT, made_up.trials()),
    ]
    return reproduction_page(spoilt(results), spoilt(reproduction.ABOUT))


def scored() -> str:
    made = spoilt(score_cards.scored(failed=["b"]))
    return score_page(ScoreEvidence(scored=made, command=MARKUP, generated_at=WHEN))


def question_map_file() -> str:
    asked = score_cards.region_score().questions
    values = asked.hands_in_base_m[:, 0]
    return question_map(asked.hands_in_base_m, values, FAR, VIEWS[0], prefix="m-", title=MARKUP)


def arms() -> str:
    arm, capsules = arm_model(Robot.UR10), arm_capsules(Robot.UR10)
    with pytest.MonkeyPatch.context() as patch, TemporaryDirectory() as folder:
        named = {"name": MARKUP, "joint_names": spoilt(arm.joint_names), "link_names": spoilt(arm.link_names)}
        patch.setattr(arm_page, "arm_model", lambda robot: replace(arm, **named))
        patch.setattr(arm_page, "arm_capsules", lambda robot: replace(capsules, names=spoilt(capsules.names)))
        arm_page.write_arm_page(Path(folder) / "arms.html", [Robot.UR10], title=MARKUP)
        return (Path(folder) / "arms.html").read_text()


def proven() -> str:
    with TemporaryDirectory() as folder:
        plan = read_proof_plan(plan_file(Path(folder), f"{PLAN}distribution: {{samples: 10}}\n"))
    asked = WrongQuestion((0.7, 0.0, 0.3), (0.7, 0.0, 0.3))
    named = (replace(one, region=replace(one.region, name=MARKUP)) for one in plan.proofs)
    return proof_page(
        ProofEvidence(
            plan=replace(plan, title=MARKUP, avoider=MARKUP),
            proofs=tuple(Proof(one, BoxTree(), asked) for one in named),
            bounds=tuple(joint_bounds(plan, fresh(plan))),
            files=(MARKUP, None),
            command=MARKUP,
            generated_at=WHEN,
        )
    )


def viewed() -> str:
    with TemporaryDirectory() as folder:
        write_view(Path(folder) / "view.html", [(MARKUP, spoilt(factory.violated_run()))] * 2)
        return (Path(folder) / "view.html").read_text()


def remembered() -> str:
    claim = {"claim": MARKUP, "expected": MARKUP, "verdict": "holds", "margin_si": 0.1, "unit": "m"}
    run = {"system": {"avoider": {"name": MARKUP}}, "source_hash": MARKUP, "claims": [claim]}
    runs = [run | {"scenario": name} for name in (MARKUP, f"{MARKUP} again")]
    found = {"format": FORMAT, "runs": runs, "overruling": {MARKUP: {"overruled": 1, "proposals": 2}}}
    with TemporaryDirectory() as folder:
        for name in ("1", "2"):
            (Path(folder) / name).mkdir()
            (Path(folder) / name / "report.json").write_text(json.dumps(found))
        write_history(
            Path(folder) / "page.html", read_history(Path(folder)), command=MARKUP, generated_at=WHEN
        )
        return (Path(folder) / "page.html").read_text()


def campaigned() -> str:
    with TemporaryDirectory() as name:
        folder = Path(name)
        with ledger_in(folder, plan_in(folder)) as ledger:
            ledger.declared = spoilt(replace(ledger.declared, world=KINEMATIC))
            for stratum, runs in enumerate((30, 20)):
                ledger.record(failed_row(plan_in(folder), stratum, k, MARKUP) for k in range(runs))
            write_campaign(folder / "page.html", ledger, state_of(ledger), command=MARKUP, generated_at=WHEN)
        return (folder / "page.html").read_text()


def compared() -> str:
    before, after = (made_up_evidence.evidence(only_shown=shown) for shown in (True, False))
    identity = Identity(())
    found = delta_between(before, after, names=("a", "b"), identities=(identity, identity), paired={})
    return delta_page(spoilt(found), command=MARKUP, generated_at=WHEN)


PAGES: dict[str, Callable[[], str]] = {
    "report.html.j2": report,
    "search.html.j2": a_search,
    "score.html.j2": scored,
    "evidence.html.j2": certified,
    "delta.html.j2": compared,
    "selftest.html.j2": tried,
    "reproduction.html.j2": reproduced,
    "arms.html.j2": arms,
    "proof.html.j2": proven,
    "view.html.j2": viewed,
    "history.html.j2": remembered,
    "campaign.html.j2": campaigned,
}


class Elements(HTMLParser):
    """What a browser would make of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.handlers: list[str] = []
        self.sources: list[str] = []
        self.text = ""
        self.scripts = ""
        self._within = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._within = tag if tag in ("script", "style") else ""
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]
        self.text += "".join(value or "" for _, value in attrs)

    def handle_data(self, data: str) -> None:
        if self._within == "script":
            self.scripts += data
        elif not self._within:
            self.text += data

    def handle_endtag(self, tag: str) -> None:
        self._within = ""


@pytest.mark.parametrize("name", PAGES)
def test_markup_stays_text_on_every_page(name: str) -> None:
    page = PAGES[name]()
    elements = Elements(page)
    assert not elements.handlers
    assert all(":" not in source.removeprefix("data:").partition("/")[0] for source in elements.sources)
    assert "alert(" not in elements.scripts
    assert "<img" not in page
    assert elements.text.count(MARKUP) > 10  # and it is there


def coverage_file() -> str:
    """As ``fuzz`` writes it."""
    counts = search.evidence().violations.counts
    drawn = coverage_map(search.evidence().coverage, counts, prefix="c-", title=MARKUP)
    return standalone(drawn, style=asset("report.css"))


XML: dict[str, Callable[[], str]] = {
    "extensions/assurance/certification/folder.py": lambda: junit_xml(spoilt(made_up_evidence.evidence())),
    "extensions/pages/coverage_map.py": coverage_file,
    "extensions/lab/pages/question_maps.py": question_map_file,
    "extensions/pages/svg.py": coverage_file,
}


@pytest.mark.parametrize("name", XML)
def test_markup_stays_text_in_every_xml_file(name: str) -> None:
    root = ElementTree.fromstring(XML[name]())
    assert {element.tag.rpartition("}")[2] for element in root.iter()}.isdisjoint({"img", "script"})
    texts = [element.text or "" for element in root.iter()]
    texts += [value for element in root.iter() for value in element.attrib.values()]
    assert any(MARKUP in text for text in texts)


def test_every_page_and_every_maker_of_xml_is_tried_here() -> None:
    package = Path(safety_harness.__file__).parent
    paper = Path(safety_harness_paper.__file__).parent
    templates = {file.name for folder in (package, paper) for file in folder.rglob("*.html.j2")}
    assert templates == {*PAGES, "page.html.j2", "parts.html.j2", "replay.html.j2"}
    makers = {file for file in package.rglob("*.py") if "ElementTree.tostring(" in file.read_text()}
    urdfs = {package / "cell/robot/description.py", package / "extensions/worlds/mujoco_model.py"}
    assert {file.relative_to(package).as_posix() for file in makers - urdfs} == set(XML)
