"""What a forger who makes every hash anew cannot change: anything but rows, which runs made again tell."""

from __future__ import annotations

import hashlib
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from once import replayed_once  # noqa: F401

from safety_harness.extensions.assurance.campaign.episodes import trace_bytes, trace_of
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.session import LEDGER, plan_of
from safety_harness.extensions.assurance.certification import folder, verify_report
from safety_harness.extensions.assurance.certification.evidence import Evidence, as_text
from safety_harness.extensions.assurance.certification.lodged import declaration_of, write_seal
from safety_harness.extensions.assurance.certification.page import render as drawn
from safety_harness.extensions.assurance.certification.verify import verify
from safety_harness.extensions.assurance.certification.verify_files import Examination
from tests.assurance.certification.forging import (
    SEARCHED,
    SEARCHING,
    Touch,
    hashed_anew,
    in_ledger,
    made_anew,
    other_software,
    report_in,
    said,
    written,
)

pytestmark = pytest.mark.usefixtures("replayed_once")
PAGE, CLAIM = "evidence.html", "claims__0"
FIRST = f"{CLAIM}__outcomes__0"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return report_in(tmp_path_factory.mktemp("forged"))


@pytest.fixture
def report(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy to be forged.  Of the evidence as it is the page is what was written; of any other one the
    forger's page is taken to be right, without the seconds that drawing takes."""
    page = (made / PAGE).read_text()
    own = hashlib.sha256(_without_files((made / "evidence.json").read_text())).digest()

    def render(evidence: Evidence, runs: object) -> str:
        text = (target / PAGE).read_text()
        same = hashlib.sha256(_without_files(as_text(evidence))).digest() == own
        return page if same else text

    monkeypatch.setattr(verify_report, "render", render)
    monkeypatch.setattr(folder, "drawn", lambda evidence, _: (page, evidence))
    target = Path(shutil.copytree(made, tmp_path / "report"))
    return target


def _without_files(text: str) -> bytes:
    return text[: text.rindex('\n "files"')].encode()


def checked(report: Path, **options: object) -> dict[str, Examination]:
    options = {"runs": 0, "seed": 1} | options
    return {check.name: check for check in verify(report, **options)}  # type: ignore[arg-type]


def faults(report: Path, **options: object) -> str:
    return "\n".join(line for check in checked(report, **options).values() for line in check.faults)


def test_nobody_touched_it(report: Path) -> None:
    hashed_anew(report)
    assert faults(report, runs=1) == ""


def plotted(claim: str, pattern: str, other: str) -> Touch:
    """In one plot of a page."""
    return written(PAGE, rf'(?s)(id="{claim}title".*?){pattern}', rf"\g<1>{other}")


TEXTS: dict[str, Touch] = {
    "the verdict in the banner": written(PAGE, "<strong>Refuted.</strong>", "<strong>Shown.</strong>"),
    "what the page claims to be": written(PAGE, "It is no certificate", "It is a certificate"),
    "that nothing proves a declaration": written(PAGE, "Nothing proves that", "It is certain that"),
    "a number in a table": written(PAGE, r'cell">\d+\.\d % to 100 %<', 'cell">0.1 % to 1 %<'),
    "by what a table is sorted": written(PAGE, 'data-sort="0.5"', 'data-sort="0.005"'),
    "a unit": written(PAGE, r"(−\d+\.\d) mm", r"\g<1> µm"),
    "a setting": written(PAGE, "<dd>400 mm</dd>", "<dd>40 mm</dd>"),
    "an assumption": written(PAGE, "<li>how hands move and are[^<]*</li>", ""),
    "a hash": written(PAGE, r"sha256 \w{4}", "sha256 0000"),
    "a command that certify does not write": written(PAGE, "safety-harness replay", "rm -rf"),
    "a colour of the style sheet": written(PAGE, "--violated: #a83a00", "--violated: #00674f"),
    "a script of its own": written(PAGE, "</main>", "</main><script>document.title='safe'</script>"),
    "the runs in the argument's picture": written(PAGE, r"(<tspan [^>]*>near): \d+ of", r"\g<1>: 777 of"),
    "a share in the argument's picture": written(PAGE, r"(<tspan [^>]*>[^<]*)50 %", r"\g<1>0.001 %"),
    "what a screen reader says of it": written(PAGE, 'aria-label="Bounds: ', 'aria-label="No bounds: '),
    "a box of the picture by a hair": plotted("argument-", r'(<rect x="\d+)\.0', r"\g<2>.1"),
    "the kind of a line of the picture": written(PAGE, 'stroke-dasharray="5 2.5"', 'stroke-dasharray="9 0"'),
    "a number below an axis": plotted("claim-1-bounds-", "50 %<", "5 %<"),
    "what is said of a plot": plotted("claim-1-bounds-", r"near: \d+\.?\d* % to 100 %", "near: 0 % to 1 %"),
    "where a bound ends": plotted("claim-1-bounds-", r'x="7\d\d\.', 'x="300.'),
    "a curve of margins": plotted("claim-1-margins-", r'd="M(\d)', r'd="M1\g<1>'),
    "the width of a line": plotted("claim-1-margins-", r'stroke-width="\d', 'stroke-width="9'),
    "a distance over time": plotted("counterexample-1-time-", r">(\d+)<", r">9\g<1><"),
    "a moment in a picture of the way": plotted("counterexample-1-top-", r"(\d\.\d)", r"9\g<1>"),
    "the coverage map's words": plotted("coverage-map-", "in 16 runs", "in 1600 runs"),
    "a square of the coverage map": plotted("coverage-map-", r'<rect x="(\d)', r'<rect x="1\g<1>'),
    "the replay's numbers": written(PAGE, r'data-packed="(\w)', r'data-packed="//\g<1>'),
    "the replay's moment": written(PAGE, r'data-jump="0\.', 'data-jump="9.'),
}  # fmt: skip


@pytest.mark.parametrize("touch", TEXTS.values(), ids=TEXTS.keys())
def test_no_text_and_no_drawing_of_the_page_can_be_another(report: Path, touch: Touch) -> None:
    touch(report)
    assert "evidence.html and evidence.json disagree" in faults(report)


SAID: dict[str, tuple[Touch, str]] = {
    "fewer violations": (said(**{f"{FIRST}__violated": 0, f"{FIRST}__holds": 10}), "outcomes[0].violated"),
    "a lower bound": (said(**{f"{FIRST}__bound__upper": 0.4}), "bound.upper"),
    "a surer bound": (said(**{f"{FIRST}__bound__confidence": 0.999}), "bound.confidence"),
    "a verdict": (said(standing="shown", **{f"{CLAIM}__standing": "shown"}), "claims[0].standing"),
    "a reason": (said(**{f"{CLAIM}__why": "none of 16 tested runs violates it"}), "claims[0].why"),
    "a target": (said(**{f"{CLAIM}__target": 0.9}), "claims[0].target"),
    "a claim's sentence": (
        said(**{f"{CLAIM}__sentence": "hand distance never below 5 mm"}),
        "claims[0].sentence",
    ),
    "a claim's unit": (said(**{f"{CLAIM}__unit": "m"}), "claims[0].unit"),
    "a scale": (said(**{f"{CLAIM}__per_si": 1.0}), "claims[0].per_si"),
    "a hazard": (said(**{f"{CLAIM}__hazard": "none"}), "claims[0].hazard"),
    "a step to a level": (said(hazards__0__steps__3="level a"), "hazards[0].steps[3]"),
    "what is asked an hour": (said(hazards__0__asked_an_hour=100.0), "hazards[0].asked_an_hour"),
    "a rate an hour": (said(hazards__0__rates__0__an_hour=1e-9), "hazards[0].rates[0].an_hour"),
    "who decided": (said(hazards__0__decided_by="an assessor"), "hazards[0].decided_by"),
    "the argument for others": (
        written("argument.gsn.yaml", "Kept rare", "Kept"),
        "argument.gsn.yaml and evidence.json disagree",
    ),
    "a note that was not in the report": (
        written("argument.yaml", '"top": ""', '"top": "approved"'),
        "argument.yaml and evidence.json disagree",
    ),
    "a margin of the curve": (said(**{f"{FIRST}__margins_si__0": 0.1}), "margins_si[0]"),
    "findings": (said(findings=[]), "findings"),
    "exclusions": (said(exclusions=["nothing"]), "exclusions"),
    "the seed": (said(plan__seed=8), "plan.seed"),
    "the plan's text": (said(plan__text="plan: another\n"), "plan.text"),
    "the confidence": (said(plan__confidence=0.999), "plan.confidence"),
    "the world": (said(plan__world="PyBullet", plan__model_only=False), "plan.model_only"),
    "the domain": (said(strata__0__about="all that hands can do"), "strata[0].about"),
    "draws that were refused": (said(strata__0__refused_draws=3), "strata[0].refused_draws"),
    "the system": (said(system__settings__0__1="1 s"), "system.settings[0][1]"),
    "the separation": (said(separation__0__distance_m=2.0), "separation[0].distance_m"),
    "the calibration": (said(calibration__0__decided="holds"), "calibration[0].decided"),
    "the coverage": (said(coverage__cells__0__runs=300), "coverage.cells[0].runs"),
    "fewer like it": (said(counterexamples__0__like_it=1), "counterexamples[0].like_it"),
    "a counterexample's margin": (said(counterexamples__0__margin="−0.1 mm"), "counterexamples[0].margin"),
    "that the search is part of the bounds": (said(counterexamples__2__independent=True), "independent"),
    "runs of the search": (said(search__runs=100_000), "search.runs"),
    "what was not measured": (said(credibility__absent=[]), "credibility.absent"),
    "where oracles were measured": (
        said(credibility__oracles_measured_with="a lab"),
        "oracles_measured_with",
    ),
    "the agreement of the worlds": (said(credibility__agreement__verdicts=1), "credibility.agreement"),
    "the version": (said(provenance__package_version="9.9"), "provenance.package_version"),
    "the source": (said(provenance__source_hash="0" * 16), "provenance.source_hash"),
    "a library": (said(provenance__libraries__0__1="9.9"), "provenance.libraries[0][1]"),
    "the machine": (said(provenance__machine="a robot cell"), "provenance.machine"),
    "the seconds": (said(provenance__run_seconds_s=1e6), "provenance.run_seconds_s"),
    "a command": (said(provenance__commands__1="safety-harness verify /elsewhere/x"), "commands"),
    "an end before the beginning": (said(provenance__ended_at="1 January 1990, 00:00 UTC"), "it ended on"),
    "the root": (said(record__rows_sha256="0" * 64), "record.rows_sha256"),
    "a declaration": (said(record__declaration_sha256="0" * 64), "record.declaration_sha256"),
    "the size of a file": (said(files__0__bytes=1), "lists wrong sizes"),
    "JUnit XML": (written("junit.xml", "<failure", "<skipped"), "junit.xml and evidence.json disagree"),
    "a plan in the folder": (written("plan/plan.yaml", "50 %", "1 %"), "plan/plan.yaml is not the ledger's"),
    "a hazard in the ledger": (
        in_ledger("UPDATE claim SET hazard = 'none'"),
        "hazards: the ledger and its plan disagree",
    ),
    "a space in the ledger": (
        in_ledger("UPDATE stratum SET space = 'all'"),
        "spaces: the ledger and its plan disagree",
    ),
    "a view of the ledger": (
        in_ledger("DROP VIEW results", "CREATE VIEW results AS SELECT 'holds' AS outcome"),
        "expected a ledger's own tables",
    ),
    "an index of the ledger": (
        in_ledger("DROP INDEX violation", "CREATE INDEX violation ON judgement (stratum) WHERE outcome = 9"),
        "expected a ledger's own tables",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("touch", "where"), SAID.values(), ids=SAID.keys())
def test_nothing_that_follows_from_the_ledger_can_be_another(report: Path, touch: Touch, where: str) -> None:
    touch(report)
    assert where in faults(report)


def test_a_kept_trace_is_the_ledgers(report: Path) -> None:
    first, *_, last = sorted((report / "counterexamples").glob("*.trace"))
    first.write_bytes(last.read_bytes())
    hashed_anew(report)
    assert f"{first.relative_to(report)} is not the trace that the ledger keeps" in faults(report)


def test_runs_that_doubt_the_simulator_are_made_again(report: Path) -> None:
    said(credibility__reruns__0__largest__0__1="+250 mm")(report)
    assert "credibility.reruns[0].largest[0][1]" in faults(report, runs=1)


def test_a_counterexample_of_the_search_is_made_again(report: Path) -> None:
    """Its trace is another run's, which no ledger knows."""
    with Ledger.open(report / LEDGER) as ledger, plan_of(ledger) as plan:
        trace = trace_of(plan, 0, (report / SEARCHED / "one.trace").read_bytes())
        ticks = trace.ticks.copy()
        ticks["demanded_joint_velocity_radps"][-1] += 1e-9
        (report / SEARCHED / "one.trace").write_bytes(trace_bytes(replace(trace, ticks=ticks)))
    hashed_anew(report)
    assert "one.trace: first difference" in faults(report, runs=1)


def test_a_file_that_no_report_has_is_named(report: Path) -> None:
    (report / "certificate.html").write_text("All is well.")
    hashed_anew(report)
    assert "certificate.html: a file that no report has" in checked(report)["numbers"].unchecked


@pytest.mark.parametrize("part", ["the library numpy", "the source of this package"])
def test_whoever_says_it_was_other_software_hides_no_text(
    report: Path, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    """Words and pages are the source's alone: another library explains no difference."""
    monkeypatch.setattr(verify_report, "render", drawn)
    TEXTS["the runs in the argument's picture"](report)
    TEXTS["a colour of the style sheet"](report)
    other_software(report, part)
    pages = checked(report)["pages"]
    assert pages.stands == (part == "the source of this package")
    said_of_it = "\n".join([*pages.faults, *pages.unchecked])
    assert "near: 777 of" in said_of_it
    assert "its style sheet differs" in said_of_it
    assert "--violated" not in said_of_it
    assert ("other software" in said_of_it) == pages.stands


def test_what_looks_like_a_style_sheet_and_is_none_is_shown(
    report: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verify_report, "render", drawn)
    written(PAGE, "<head>", "<head><!--<style>-->All is well.</style>")(report)
    other_software(report)
    assert "All is well." in "\n".join(checked(report)["pages"].faults)


# What nothing but the report itself says, or only a run made again would tell: a lodged seal does.
SEALED: dict[str, Touch] = {
    "a row": in_ledger("UPDATE judgement SET margin = margin + 1e-9 WHERE claim = 1 AND episode = 5"),
    "a run error": in_ledger("UPDATE episode SET mishap = 'it hung' WHERE episode = 5"),
    "seconds": in_ledger("UPDATE episode SET seconds = 1.0"),
    "who ran it": in_ledger("UPDATE session SET machine = 'another'"),
    "when it was run": in_ledger("UPDATE session SET began = '2020-01-01T00:00:00+00:00'"),
    "when it was written": said(provenance__ended_at="1 January 2090, 00:00 UTC"),
    "what the search tried": written(f"{SEARCHED}/findings.json", '"default"', '"thorough"'),
    "a file beside": lambda report: (report / "more.txt").write_text("x") and hashed_anew(report),
}


@pytest.mark.parametrize("touch", SEALED.values(), ids=SEALED.keys())
def test_nothing_at_all_can_be_altered_after_a_seal_was_lodged(report: Path, touch: Touch) -> None:
    lodged = write_seal(report).sha256
    assert checked(report, seal=lodged)["lodged"].stands
    touch(report)
    assert f"the seal of this report is {write_anew(report)}" in faults(report, seal=lodged)
    where = report.with_name("report.seal.json")
    assert "changed after the seal" in faults(report, seal=str(where))


def write_anew(report: Path) -> str:
    file = report.with_name("report.seal.json")
    first = file.read_text()
    file.unlink()
    sha256 = write_seal(report).sha256
    file.write_text(first)
    return sha256


def test_without_a_seal_it_says_what_a_careful_forger_could_do(report: Path) -> None:
    (no_seal, not_declared) = checked(report)["lodged"].unchecked
    assert "a careful forger may have altered rows and renewed all hashes" in no_seal
    assert "it would prove that plan" in not_declared


def test_a_target_raised_after_the_results_is_seen_by_the_lodged_declaration(report: Path) -> None:
    with Ledger.open(report / LEDGER) as ledger, plan_of(ledger) as plan:
        lodged = declaration_of(plan)
    assert checked(report, declared=lodged.sha256)["lodged"].stands
    made_anew(report, SEARCHING.replace("50 %", "49 %"))
    assert "it would prove that plan, seed and targets came first" in checked(report)["lodged"].unchecked[1]
    assert faults(report) == ""
    assert "not the lodged hash" in faults(report, declared=lodged.sha256)
    where = report.with_name("was.declared.json")
    where.write_text(lodged.as_json)
    assert "0.5 was declared, and it is 0.49 now" in faults(report, declared=str(where))


def test_the_forgeries_are_at_least_forty() -> None:
    assert len(TEXTS) + len(SAID) >= 40
