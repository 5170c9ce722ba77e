"""Search a space for violations: ``safety_harness.fuzz``, its result, and the result's page."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

from safety_harness.admission.avoiders import one_of, reference_for
from safety_harness.base.exceptions import OutputError, ScenarioError
from safety_harness.base.interrupts import one_more_ctrl_c
from safety_harness.base.output import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED, QUIET, Output
from safety_harness.base.whole_file import write_text
from safety_harness.report.page_parts import asset
from safety_harness.report.search_attribution import SearchAttribution
from safety_harness.report.search_files import as_json, evidence_of, fuzz_command
from safety_harness.report.search_page import SearchEvidence, map_of, render
from safety_harness.report.svg import standalone
from safety_harness.search.against import Reference
from safety_harness.search.findings import Findings
from safety_harness.search.sampling import UniformSampling
from safety_harness.search.searchers import searcher_named
from safety_harness.search.session import (
    FINDINGS,
    SearchSession,
    WrittenCounterexample,
    basis_of_search,
    search_space,
)
from safety_harness.search.trials import Trials, in_kinematic
from safety_harness.space.read import read_space
from safety_harness.space.space import ScenarioSpace

PAGE, COVERAGE = "fuzz.html", "coverage.svg"


def fuzz(
    space: str | Path | ScenarioSpace,
    *,
    avoider: str | None = None,
    controller: str | None = None,
    against: str | None = None,
    budget: int = 1000,
    seed: int = 0,
    searcher: str = "default",
    claims: tuple[str, ...] | list[str] = (),
    baseline: bool = False,
    out: str | Path | None = None,
    output: Output = QUIET,
) -> SearchResult:
    """Search a scenario space for violations; shrink, confirm and attribute what was found.

    Args:
        space: A file, ``shipped:NAME``, or a ``ScenarioSpace``.
        avoider: What proposes retreats in place of what the space names.
        controller: What drives the arm in place of the visual servo.
        against: A reference: search for what it does not violate in the same draws.
        budget: Runs to search with; shrinking has its own.
        seed: Root of every random number.
        searcher: A name that ``searcher_named`` takes.
        claims: Sentences in place of the space's claims.
        baseline: Sample the space uniformly as well, with the same budget.
        out: A folder that keeps each finding as soon as it is found.
        output: What hears of the progress.

    Ctrl-C ends the search, and the result keeps what was found.

    Raises:
        InputError: The space or an option cannot be used.

    """
    if budget < 1:
        raise ScenarioError.of_option("--budget", "at least 1 run", str(budget))
    make = searcher_named(searcher)
    if baseline and make is UniformSampling:
        expected = "another searcher, to compare with uniform sampling"
        raise ScenarioError.of_option("--baseline", expected, "--searcher uniform")
    attribution = SearchAttribution()
    asked = one_of(avoider, controller)
    reference = reference_for(asked, against)
    session = search_space(
        Trials(
            space if isinstance(space, ScenarioSpace) else read_space(space),
            in_kinematic,
            seed=seed,
            avoider=asked,
            sentences=tuple(claims),
            reference=None if reference is None else Reference(reference),
        ),
        make,
        out=None if out is None else Path(out),
        budget=budget,
        output=output,
        baseline=baseline,
        explain=attribution.explain,
    )
    if session.unwritable is not None:
        return SearchResult(session, None, session.interrupted, session.unwritable)
    evidence = evidence_of(session, attribution)
    if evidence.faults is not None:
        output.say(evidence.faults.words)
    if session.trials.times.words:
        output.say(f"computing time: {session.trials.times.words}")
    return SearchResult(session, evidence, session.interrupted)


@dataclass(frozen=True, eq=False, repr=False)
class SearchResult:
    """What a search found.

    Args:
        session: The search, with every finding.
        evidence: What the page shows; None where the disk took no more.
        interrupted: Ctrl-C ended it.
        unwritable: Why no more was written.

    """

    session: SearchSession
    evidence: SearchEvidence | None
    interrupted: bool
    unwritable: OutputError | None = None

    @property
    def findings(self) -> Findings:
        """Counts, groups of violations and the nearest margins."""
        return self.session.findings

    @property
    def counterexamples(self) -> tuple[WrittenCounterexample, ...]:
        """The counterexamples, each with its scenario and why it violates."""
        return tuple(self.session.written)

    @property
    def exit_code(self) -> int:
        """The command's exit code."""
        if self.unwritable is not None:
            return BAD_INPUT
        if self.interrupted:
            return INTERRUPTED
        repeated = self.session.repeated
        alike = repeated is None or not repeated.problem
        return DIFFERS if self.session.differs or not alike else AS_EXPECTED

    def __repr__(self) -> str:
        findings, found = self.findings, len(self.counterexamples)
        runs = sum(group.count for group in findings.groups if group.claim is not None)
        words = f"{found} counterexamples of {runs} violating runs" if runs else "no violation found"
        basis = basis_of_search(findings, self.session.confirmed)
        return f"<{self.session.trials.space.name}: {words} in {findings.tried} runs. {basis}>"

    def data(self) -> dict[str, object]:
        """Return what findings.json holds; empty where the disk took no more."""
        return {} if self.evidence is None else as_json(self.session.trials, self.evidence)

    def write(self, folder: str | Path, output: Output = QUIET) -> SearchResult:
        """Write fuzz.html, findings.json, coverage.svg, and each finding that is not there yet as a file.

        The result that is returned names the files of the folder.  A first Ctrl-C lets it end.

        Raises:
            OutputError: The folder cannot be written.

        """
        out = Path(folder)
        session = self.session.moved_to(out)
        if session.unwritable is not None:
            raise session.unwritable
        if self.evidence is None:
            raise ScenarioError.of_option("write(folder)", "a search that came to its end", "a full disk")
        evidence = replace(self.evidence, command=fuzz_command(session), shown=tuple(session.written))
        made = replace(self, session=session, evidence=evidence)
        with one_more_ctrl_c(output.say, f"writing {out / PAGE}; Ctrl-C once more gives it up") as asked:
            write_text(out / FINDINGS, json.dumps(made.data(), indent=1) + "\n")
            write_text(out / COVERAGE, standalone(map_of(evidence), style=asset("report.css")))
            write_text(out / PAGE, render(evidence))
        output.say(f"page: {out / PAGE} (for programs: {FINDINGS})")
        return replace(made, interrupted=self.interrupted or asked())

    def kept(self, folder: Path, output: Output) -> SearchResult:
        """Write it, and say what keeps it from being written, and how to run the counterexamples again."""
        made = self
        if self.unwritable is None:
            try:
                made = self.write(folder, output)
            except OutputError as error:
                made = replace(self, unwritable=error)
            except KeyboardInterrupt:
                made = replace(self, interrupted=True)
                output.say(f"no page was written; the files are in {folder}")
        output.say(*made.session.last_lines(made.unwritable))
        return made
