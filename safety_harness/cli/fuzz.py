"""``safety-harness fuzz``: search a space for violations, shrink, confirm, explain and write them down."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from safety_harness.admission.elsewhere import as_seen_from
from safety_harness.cli.console import (
    AS_EXPECTED,
    BAD_INPUT,
    DIFFERS,
    INTERRUPTED,
    explain,
    one_more_ctrl_c,
    result,
    say,
    say_shared_modules,
)
from safety_harness.cli.fuzz_json import complaint_of
from safety_harness.cli.fuzz_page import FINDINGS, PAGE, WrittenCounterexample, evidence_of, write_all
from safety_harness.cli.fuzz_progress import FuzzProgress, nearest_lines, remarks, summary
from safety_harness.cli.show import write_text
from safety_harness.exceptions import InputError, OutputError, Place, ScenarioError
from safety_harness.properties.answered import fallback_words
from safety_harness.report.search_page import MOST_DRAWN
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.write import write_scenario
from safety_harness.search.confirm import Complaint
from safety_harness.search.counterexample import Counterexample, counterexample_of, origin_of, text_of
from safety_harness.search.coverage import Coverage
from safety_harness.search.cube import Cube
from safety_harness.search.disagreement import Disagreement, disagreement_of
from safety_harness.search.findings import Findings, Group, TriedPoint
from safety_harness.search.sampling import UniformSampling
from safety_harness.search.search import find_violations
from safety_harness.search.searchers import MakesSearcher, searcher_named
from safety_harness.search.trials import ScenarioRunner, Trials, in_kinematic, in_pybullet
from safety_harness.space.read import read_space
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace

AS_FOUND = "as-found"
_MOST_SHRUNK = 3  # counterexamples of one claim, and of mishaps
_MOST_AS_FOUND = 50  # files
_SHRINKING = 200  # runs for each
_BATCH = 64  # runs that go to their decisions together


def fuzz(
    file: Path,
    *,
    out: Path,
    avoider: str | None = None,
    budget: int = 1000,
    seed: int = 0,
    searcher: str = "default",
    claims: Sequence[str] = (),
    baseline: bool = False,
) -> int:
    """Search, shrink, confirm, explain, write; returns the exit code.

    ``baseline`` samples the space uniformly as well, with the same budget, to compare with.
    """
    try:
        say_shared_modules()
        if budget < 1:
            raise ScenarioError(place=Place(field="--budget"), expected="at least 1 run", got=str(budget))
        make = searcher_named(searcher)
        if baseline and make is UniformSampling:
            raise ScenarioError(
                place=Place(field="--baseline"),
                expected="another searcher, to compare with uniform sampling",
                got="--searcher uniform",
            )
        trials = Trials(read_space(file), in_kinematic, seed=seed, avoider=avoider, sentences=tuple(claims))
        session = _Session(trials, out, budget)
        session.search(make)
        if baseline:
            session.sample()
        session.conclude()
    except InputError as error:
        explain(error)
        return BAD_INPUT
    except KeyboardInterrupt:
        say("interrupted before anything was tried")
        return INTERRUPTED
    return session.exit_code


@dataclass(eq=False)
class _Session:
    """One search and what becomes of its findings.  What cannot be written is printed instead."""

    trials: Trials
    out: Path
    budget: int
    confirming: ScenarioRunner = in_pybullet
    baseline: Findings | None = None
    written: list[WrittenCounterexample] = field(default_factory=list)
    confirmed: int = 0
    unwritable: OutputError | None = None
    unconfirmed: list[Disagreement] = field(default_factory=list)

    def search(self, make: MakesSearcher) -> None:
        """Until the budget is spent, Ctrl-C, or a disk that takes no more."""
        self.findings = self._search(make, self.trials)

    def sample(self) -> None:
        """The baseline, with counts of its own; unless the search was interrupted."""
        if not self.findings.interrupted and self.unwritable is None:
            say("the baseline: uniform sampling with the same budget")
            anew = replace(self.trials, coverage=Coverage(), violations=Coverage())
            self.baseline = self._search(UniformSampling, anew, folder="baseline")
            self.findings.interrupted = self.baseline.interrupted

    def _search(self, make: MakesSearcher, trials: Trials, folder: str = "") -> Findings:
        cube = Cube.of(trials.space)
        searcher = make(cube, claims=len(trials.goals), seed=trials.seed)
        progress = FuzzProgress(self.budget)
        saved = 0

        def keep(findings: Findings) -> None:
            nonlocal saved
            for group in findings.groups[saved:_MOST_AS_FOUND]:
                self._save_as_found(group, self.out / AS_FOUND / folder, saved, findings)
                saved += 1
            progress.show(findings)

        with progress.running():
            return find_violations(
                cube,
                trials.goals,
                trials,
                searcher,
                budget=self.budget,
                batch=_BATCH,
                on_progress=keep,
                enough=lambda findings: self.unwritable is not None,
            )

    def conclude(self) -> None:
        """Shrink and report, unless the search was interrupted."""
        findings = self.findings
        fallback = fallback_words(self.trials.unanswered, self.trials.decisions)
        whole = summary(findings, self.budget) + (f"; {fallback}" if fallback else "")
        for line in (*self.trials.space.notes, whole, *nearest_lines(findings)):
            say(line)
        if self.baseline is not None:
            for line in (f"uniform: {summary(self.baseline, self.budget)}", *nearest_lines(self.baseline)):
                say(line)
        if findings.interrupted:
            say("interrupted: what was found is kept as it was found, not shrunk")
        elif self.unwritable is None:
            for claim in (*range(len(findings.goals)), None):
                self._shrink_groups(claim)
        for line in remarks(self.trials, findings):
            say(line)
        if self.unconfirmed:
            say(f"{len(self.unconfirmed)} findings were not confirmed in PyBullet; they are in {FINDINGS}")
        self._save_page()
        if self.written:
            say("again: " + shlex.join(["safety-harness", "run", *(str(one.path) for one in self.written)]))
        if self.unwritable is not None:
            explain(self.unwritable)

    def _shrink_groups(self, claim: int | None) -> None:
        """Of the search; what only the baseline met is worth as much."""
        searches = [self.findings] if self.baseline is None else [self.findings, self.baseline]
        findings = next((one for one in searches if one.of_claim(claim)), self.findings)
        groups = _one_of_each_kind_first(findings.of_claim(claim))
        told: list[WrittenCounterexample] = []
        tried = shrunk = 0
        for group in groups:
            if len(told) == _MOST_SHRUNK or shrunk == 2 * _MOST_SHRUNK or self.findings.interrupted:
                break
            one = self._counterexample(group, len(told) + 1)
            tried, shrunk = tried + 1, shrunk + (one is not None)
            if one is None:
                continue
            same = next((other for other in told if one.is_same_as(other.one)), None)
            if same is None:
                told.append(self._save(one, group, findings))
            else:
                same.groups.append(group)
        for written in told:
            _tell(written)
        left = groups[tried:]
        if left and not self.findings.interrupted:
            runs = sum(group.count for group in left)
            say(
                f"{findings.sentence_of(left[0])}: {len(left)} more groups of violations ({runs} runs) were "
                f"not shrunk; they may be the same or others ({FINDINGS}, {AS_FOUND})"
            )

    def _counterexample(self, group: Group, number: int) -> Counterexample | None:
        complaint = complaint_of(self.trials, group)
        path = self.out / f"{self.trials.space.name}-{_slug(complaint.sentence)}-{number}.yaml"
        found = replace(self._found(group.worst), file=path, name=path.stem)
        try:
            one = counterexample_of(found, complaint, self.confirming, budget=_SHRINKING)
        except KeyboardInterrupt:
            self.findings.interrupted = True
            return None
        if one is None:
            self.unconfirmed.append(self._disagreement(group, complaint, found))
            say(f"not confirmed in PyBullet: {complaint.sentence}, point {group.worst.number}")
            return None
        self.confirmed += 1
        self.findings.interrupted |= one.shrunk.interrupted
        return one

    def _disagreement(self, group: Group, complaint: Complaint, found: Scenario) -> Disagreement:
        if len(self.unconfirmed) >= MOST_DRAWN:
            return Disagreement(group, complaint)
        return disagreement_of(group, complaint, found, self.trials.world, self.confirming)

    def _found(self, episode: TriedPoint) -> Scenario:
        return as_seen_from(self.out, self.trials.scenario(episode.point, episode.number))

    def _origin(self, episode: TriedPoint, findings: Findings) -> list[str]:
        trials = self.trials
        return origin_of(trials.space, episode.point, episode.number, trials.seed, findings.searcher)

    def _save(self, one: Counterexample, group: Group, findings: Findings) -> WrittenCounterexample:
        path = one.shrunk.scenario.file
        assert path is not None
        trace_file = path.with_suffix(".trace") if isinstance(one.run, Trace) else None
        text = text_of(one, self._origin(group.worst, findings), trace_file)
        if self._write(path, text) and isinstance(one.run, Trace) and trace_file is not None:
            try:
                save_trace(one.run, trace_file)
            except OSError as error:
                self.unwritable = OutputError.of(trace_file, error)
        self.written.append(WrittenCounterexample(one, [group], findings.searcher, path, trace_file, text))
        return self.written[-1]

    def _save_as_found(self, group: Group, folder: Path, number: int, findings: Findings) -> None:
        """At once, so that nothing that happens later loses it."""
        complaint = complaint_of(self.trials, group)
        name = f"{self.trials.space.name}-{_slug(complaint.sentence)}-{number + 1}.yaml"
        path = folder / name
        found = as_seen_from(path.parent, self.trials.scenario(group.first.point, group.first.number))
        claims = (
            replace(claim, expected=Verdict.VIOLATED) if claim == complaint.claim else claim
            for claim in found.claims
        )
        head = [f"As found, not shrunk: {complaint.sentence}", *self._origin(group.first, findings)]
        comments = "".join(f"# {line}\n" for line in head)
        self._write(path, comments + "\n" + write_scenario(replace(found, claims=tuple(claims))))

    def _write(self, path: Path, text: str) -> bool:
        try:
            if self.unwritable is None:
                write_text(path, text)
                return True
        except OutputError as error:
            self.unwritable = error
        result(f"# --- {path} (which could not be written)\n{text}# ---")
        return False

    def _save_page(self) -> None:
        """What was written beside the counterexamples, at the end."""
        if self.unwritable is not None:
            return
        evidence = evidence_of(
            self.trials,
            out=self.out,
            budget=self.budget,
            findings=self.findings,
            baseline=self.baseline,
            written=self.written,
            confirmed=self.confirmed,
            unconfirmed=self.unconfirmed,
        )
        try:
            with one_more_ctrl_c(f"writing {self.out / PAGE}; Ctrl-C once more gives it up") as asked:
                write_all(self.out, self.trials, evidence)
            say(f"page: {self.out / PAGE} (for programs: {FINDINGS})")
            self.findings.interrupted |= asked()
        except OutputError as error:
            self.unwritable = error
        except KeyboardInterrupt:
            self.findings.interrupted = True
            say(f"no page was written; the files are in {self.out}")

    @property
    def exit_code(self) -> int:
        """0 nothing that was confirmed, 1 something, 2 not all could be written, 130 interrupted."""
        if self.unwritable is not None:
            return BAD_INPUT
        if self.findings.interrupted:
            return INTERRUPTED
        return DIFFERS if self.written else AS_EXPECTED


def _tell(written: WrittenCounterexample) -> None:
    """What was found, once: however many groups of runs shrank to it."""
    one, runs = written.one, written.shown.runs
    margin = "-" if one.evaluation is None else one.evaluation.margin_text()
    apart = f" in {len(written.groups)} groups that lie apart" if len(written.groups) > 1 else ""
    result(f"violated {margin:>13}  {one.complaint.words}")
    result(f"  {written.path}: {runs} runs led to it{apart}; shrunk in {one.shrunk.used} runs")
    for line in one.explanation:
        result(f"  {line}")


def _one_of_each_kind_first(groups: Sequence[Group]) -> list[Group]:
    """The worst of each kind, then the others."""
    firsts: dict[str, Group] = {}
    for group in groups:
        firsts.setdefault(group.kind, group)
    return [*firsts.values(), *(group for group in groups if firsts[group.kind] is not group)]


def _slug(sentence: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", sentence.lower()).strip("-")[:60].rstrip("-")
