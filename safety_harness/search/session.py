"""A whole search of a space: find violations, shrink, confirm and explain them, write each one down.

As findings come they are saved as found; at the end the worst of each kind is shrunk, until there are
three structures, or six groups were shrunk.  Nothing that happens later loses what was found.
"""

from __future__ import annotations

import re
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from safety_harness.admission.avoiders import as_seen_from
from safety_harness.admission.repeatability import RepeatabilityResult
from safety_harness.base.exceptions import OutputError, explanation
from safety_harness.base.output import Output, where
from safety_harness.base.seeds import Branch
from safety_harness.base.seeds import seed as leaf
from safety_harness.base.whole_file import write_text, writing
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET
from safety_harness.claims.properties.against import Against
from safety_harness.claims.properties.answered import fallback_words
from safety_harness.claims.properties.base import Unit, close_to, far_words
from safety_harness.claims.properties.tally import basis
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.write import write_scenario
from safety_harness.search.confirm import Complaint, Disagreement, disagreement_of
from safety_harness.search.counterexample import (
    Counterexample,
    Explain,
    counterexample_of,
    origin_of,
    text_of,
    unexplained,
)
from safety_harness.search.coverage import Coverage
from safety_harness.search.cube import Cube
from safety_harness.search.findings import RUN_FAILED, Findings, Group, TriedPoint
from safety_harness.search.redrawn import keep_differences, more_overruled
from safety_harness.search.sampling import UniformSampling
from safety_harness.search.search import find_violations
from safety_harness.search.searchers import MakesSearcher
from safety_harness.search.trials import ScenarioRunner, Trials, in_kinematic, in_pybullet
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace

FINDINGS, AS_FOUND = "findings.json", "as-found"
AS_EXPECTED = " (as the space expects)"
NOT_CONFIRMED = f"not confirmed in {PYBULLET.label}"
NO_REFERENCE = f"nothing is confirmed in {PYBULLET.label}, which is not installed: this is {KINEMATIC} alone"
MOST_SHRUNK = 3  # counterexamples of one claim, and of mishaps
SHRINKING_RUNS = 200  # for each
MOST_RUN_TWICE = 8  # disagreements of the worlds of which both runs are made, to be shown
_MOST_AS_FOUND = 1_000  # files
LEAST_DRAWN = 300  # pairs of runs anywhere in the space: fewer tell no 3 % from chance
_BATCH = 64  # runs that go to their decisions together


def basis_of_search(findings: Findings, confirmed: int) -> str:
    """Say what a search's findings rest on; ``confirmed`` is how many PyBullet shows too."""
    counts = [(int(runs), findings.tried) for runs in findings.evidence]
    return basis([str(KINEMATIC), *[str(PYBULLET)] * bool(confirmed)], counts)


def _tell(tell: Callable[[str], None], where: str, what: str) -> None:
    tell(f"{where}: {what}")


@dataclass(frozen=True, eq=False)
class WrittenCounterexample:
    """A counterexample, the groups of runs that shrank to it, the searcher of its first, and its files.

    ``expected``: the space says that the claim is violated somewhere.
    """

    one: Counterexample
    groups: list[Group]
    searcher: str
    path: Path
    trace_file: Path | None
    text: str
    expected: bool

    @property
    def lines(self) -> list[str]:
        """What was found, once: however many groups of runs shrank to it."""
        one, runs = self.one, sum(group.count for group in self.groups)
        margin = "-" if one.evaluation is None else one.evaluation.margin_text()
        apart = f" in {len(self.groups)} groups that lie apart" if len(self.groups) > 1 else ""
        return [
            f"violated {margin:>13}  {one.complaint.words}{AS_EXPECTED if self.expected else ''}",
            f"  {self.path}: {runs} runs led to it{apart}; shrunk in {one.shrunk.used} runs",
            *(f"  {line}" for line in one.explanation),
        ]


@dataclass(eq=False)
class SearchSession:
    """One search and what becomes of its findings.  What cannot be written is printed instead.

    ``baseline`` is uniform sampling with the same budget, ``confirmed`` counts the findings that the world
    ``confirming`` shows as well.  Without a ``reference`` that is the world that was searched, and they are
    none.  ``unwritable`` is why no more is written.  ``explain`` says of each why it violates.  ``repeated``
    is what a second avoider answered to questions of the search; None if it was not asked.  ``flips`` are
    differences from a reference that are none when they are drawn again, ``overruled`` says that more of the
    avoider's proposals are than of the reference's.  ``keeps``: findings are written to
    ``out`` as they come.
    """

    trials: Trials
    out: Path
    budget: int
    output: Output
    confirming: ScenarioRunner = in_pybullet
    reference: bool = True
    explain: Explain = unexplained
    findings: Findings = field(init=False)
    baseline: Findings | None = None
    written: list[WrittenCounterexample] = field(default_factory=list)
    confirmed: int = 0
    unwritable: OutputError | None = None
    unconfirmed: list[Disagreement] = field(default_factory=list)
    repeated: RepeatabilityResult | None = None
    flips: list[str] = field(default_factory=list)
    overruled: str = ""
    keeps: bool = True

    @property
    def interrupted(self) -> bool:
        """Was it ended by Ctrl-C?"""
        return self.findings.interrupted

    @property
    def not_found(self) -> list[str]:
        """Claims that the space expects to be violated, and no confirmed counterexample violates."""
        missing = self.trials.to_be_found - {one.one.complaint.sentence for one in self.written}
        goals = zip(self.trials.goals, self.trials.of_others, strict=True)
        return [goal.sentence for goal, of_others in goals if goal.sentence in missing and not of_others]

    @property
    def differs(self) -> bool:
        """Was anything found that the space does not expect, not found what it does, or nothing known?"""
        applicable = ~self.trials.of_others  # of the other claims nothing can be known
        unknown = bool(self.findings.tried) and not applicable.any()
        unknown |= not self.findings.evidence[applicable].all()  # of a claim that no run put to the test
        unknown |= bool(self.overruled or self.not_found)
        return unknown or not all(one.expected for one in self.written)

    def search(self, make: MakesSearcher, trials: Trials, folder: str | None = "") -> Findings:
        """Until the budget is spent, Ctrl-C, or a disk that takes no more; without a folder none is saved."""
        cube = Cube.of(trials.space)
        saved = _MOST_AS_FOUND if folder is None else 0
        budget = max(self.budget, LEAST_DRAWN) if folder is None else self.budget

        def keep(findings: Findings) -> None:
            nonlocal saved
            for group in findings.groups[saved:_MOST_AS_FOUND]:
                self._save_as_found(group, self.out / AS_FOUND / (folder or ""), saved, findings)
                saved += 1
            show(findings)

        with watching_search(budget, self.output) as show:
            return find_violations(
                cube,
                trials.goals,
                trials,
                make(cube, claims=len(trials.goals), seed=trials.seed),
                budget=budget,
                batch=_BATCH,
                on_progress=keep,
                enough=lambda findings: self.unwritable is not None,
            )

    def conclude(self) -> None:
        """Shrink, unless the search was interrupted, and say what was found."""
        findings, say = self.findings, self.output.say
        fallback = fallback_words(self.trials.unanswered, self.trials.decisions)
        self._draw_again()
        whole = summary(findings, self.budget) + (f"; {fallback}" if fallback else "")
        overruled = filter(None, [self.trials.overruling.words])
        lines = [*self.trials.space.notes, whole, *overruled, *nearest_lines(findings)]
        if self.baseline is not None:
            lines += [f"uniform: {summary(self.baseline, self.budget)}", *nearest_lines(self.baseline)]
        alone = len(findings.groups) - _MOST_AS_FOUND
        if alone > 0:
            lines.append(
                f"{AS_FOUND} has the first {_MOST_AS_FOUND:,} groups; {alone:,} are in {FINDINGS} alone"
            )
        for line in lines:
            say(line)
        self._ask_again()
        if findings.interrupted:
            say("interrupted: what was found is kept as it was found, not shrunk")
        elif self.unwritable is None:
            for claim in (*range(len(findings.goals)), None):
                self._shrink_groups(claim)
        for line in remarks(self.trials, findings, self.overruled):
            say(line)
        say(basis_of_search(findings, self.confirmed))
        for sentence in self.not_found:
            self.output.result(f"NOT FOUND  {sentence}: {not_found_words(findings)}")
        if self.written and not self.reference:
            say(NO_REFERENCE)
        if self.unconfirmed:
            say(f"{len(self.unconfirmed)} findings were {NOT_CONFIRMED}; they are in {FINDINGS}")

    def last_lines(self, unwritable: OutputError | None) -> list[str]:
        """Return how to run the counterexamples again, and what could not be written."""
        lines = []
        if self.written:
            again = ["safety-harness", "run", *(str(one.path) for one in self.written)]
            reference = self.trials.reference
            again += [] if reference is None else ["--against", reference.name]
            again += [] if self.reference else ["--world", KINEMATIC.label]
            lines.append("next: " + shlex.join(again))
        return lines + ([] if unwritable is None else [f"error: {explanation(unwritable)}"])

    def moved_to(self, folder: Path) -> SearchSession:
        """Return the session with its findings in a folder, and write there what it does not keep there."""
        if self.keeps and folder == self.out:
            return self
        moved = replace(self, out=folder, keeps=True, written=[], unwritable=None)
        moved.findings = self.findings
        for findings, name in ((self.findings, ""), (self.baseline, "baseline")):
            groups = [] if findings is None else findings.groups[:_MOST_AS_FOUND]
            for number, group in enumerate(groups):
                assert findings is not None
                moved._save_as_found(group, folder / AS_FOUND / name, number, findings)
        for old in self.written:
            file = folder / old.path.name
            one, run = old.one, old.one.run
            if isinstance(run, Trace):
                run = replace(run, scenario=replace(as_seen_from(folder, run.scenario), file=file))
            scenario = replace(as_seen_from(folder, one.shrunk.scenario), file=file)
            one = replace(one, run=run, shrunk=replace(one.shrunk, scenario=scenario))
            moved._save(one, old.groups, old.searcher)
        return moved

    @cached_property
    def _drawn(self) -> Trials:
        """Run at least as many pairs of the space as the search, which nobody chose."""
        self.output.say("runs anywhere in the space with both, to hold what was found against")
        own = leaf(self.trials.seed, Branch.SEARCH, 6)
        drawn = replace(self.trials, seed=own, coverage=Coverage(), violations=Coverage())
        if self.search(UniformSampling, drawn, folder=None).interrupted:
            raise KeyboardInterrupt
        return drawn

    def _draw_again(self) -> None:
        """Which differences from a reference are none?  Not after an interruption."""
        try:
            for one in filter(None, [self.findings, self.baseline] if not self.interrupted else []):
                self.flips += keep_differences(self.trials, one, lambda: self._drawn)
            if not self.interrupted:
                self.overruled = more_overruled(self.trials, lambda: self._drawn)
        except KeyboardInterrupt:
            self.findings.interrupted = True
        for line in self.flips:
            self.output.say(f"flips near the limit: {line}")
        if self.overruled:
            self.output.result(f"OVERRULED  {self.overruled}")

    def _ask_again(self) -> None:
        """Does the avoider answer alike when it is asked again?  Not after an interruption."""
        if not self.interrupted:
            self.repeated = self.trials.repeatability.reported(self.output)
            self.findings.interrupted = self.repeated is None

    def _origin(self, group: Group, searcher: str) -> list[str]:
        """Where the counterexample of a group comes from, and that its avoider does not answer alike."""
        doubt = [self.repeated.line] if self.repeated is not None and self.repeated.words else []
        doubt += [] if self.reference else [NO_REFERENCE]
        return [*doubt, *origin_of(self.trials, group.worst, searcher)]

    def _shrink_groups(self, claim: int | None) -> None:
        """Of the search; what only the baseline met is worth as much."""
        searches = [self.findings] if self.baseline is None else [self.findings, self.baseline]
        findings = next((one for one in searches if one.of_claim(claim)), self.findings)
        groups = _one_of_each_kind_first(findings.of_claim(claim))
        told: list[WrittenCounterexample] = []
        tried = shrunk = 0
        with self.output.words() as tell:
            for group in groups:
                if len(told) == MOST_SHRUNK or shrunk == 2 * MOST_SHRUNK or self.findings.interrupted:
                    break
                at = f"violation {tried + 1} of {len(groups)} that lie apart, {findings.sentence_of(group)}"
                one = self._counterexample(group, len(told) + 1, partial(_tell, tell, at))
                tried, shrunk = tried + 1, shrunk + (one is not None)
                if one is None:
                    continue
                for same in told:
                    if one.is_same_as(same.one):
                        same.groups.append(group)
                        break
                else:
                    told.append(self._save(one, [group], findings.searcher))
        for written in told:
            for line in written.lines:
                self.output.result(line)
        left = groups[tried:]
        if left and not self.findings.interrupted:
            runs = sum(group.count for group in left)
            self.output.say(
                f"{findings.sentence_of(left[0])}: {len(left)} more groups of violations ({runs} runs) were "
                f"not shrunk; they may be the same or others ({FINDINGS}, {AS_FOUND})"
            )

    def _counterexample(
        self, group: Group, number: int, on_step: Callable[[str], None]
    ) -> Counterexample | None:
        complaint = complaint_of(self.trials, group)
        path = self._file(self.out, complaint, number)
        one = None
        for episode in (group.worst, *group.others):
            found = replace(self._found(self.out, episode), file=path, name=path.stem)
            try:
                one = counterexample_of(
                    found,
                    complaint,
                    self.confirming,
                    budget=SHRINKING_RUNS,
                    sooner=self.trials.world if self.reference else None,
                    explain=self.explain,
                    on_step=on_step,
                )
            except KeyboardInterrupt:
                self.findings.interrupted = True
                return None
            if one is not None:
                group.worst = episode
                break
        if one is None:
            self.unconfirmed.append(
                disagreement_of(group, complaint, found, self.trials.world, self.confirming)
                if len(self.unconfirmed) < MOST_RUN_TWICE
                else Disagreement(group, complaint)
            )
            self.output.say(f"{NOT_CONFIRMED}: {complaint.sentence}, point {group.worst.number}")
            return None
        self.confirmed += self.reference
        self.findings.interrupted |= one.shrunk.interrupted
        return one

    def _file(self, folder: Path, complaint: Complaint, number: int) -> Path:
        words = re.sub(r"[^a-z0-9]+", "-", complaint.sentence.lower()).strip("-")[:60].rstrip("-")
        return folder / f"{self.trials.space.name}-{words}-{number}.yaml"

    def _found(self, folder: Path, episode: TriedPoint) -> Scenario:
        return as_seen_from(folder, self.trials.scenario(episode.point, episode.number))

    def _save(self, one: Counterexample, groups: list[Group], searcher: str) -> WrittenCounterexample:
        path = one.shrunk.scenario.file
        assert path is not None
        trace_file = path.with_suffix(".trace") if isinstance(one.run, Trace) else None
        text = text_of(one, self._origin(groups[0], searcher), trace_file)
        if self._write(path, text) and self.keeps and isinstance(one.run, Trace) and trace_file is not None:
            try:
                with writing(trace_file):
                    save_trace(one.run, trace_file)
            except OutputError as error:
                self.unwritable = error
        expected = one.complaint.claim is not None and one.complaint.sentence in self.trials.to_be_found
        self.written.append(WrittenCounterexample(one, groups, searcher, path, trace_file, text, expected))
        return self.written[-1]

    def _save_as_found(self, group: Group, folder: Path, number: int, findings: Findings) -> None:
        """At once, so that nothing that happens later loses it."""
        complaint = complaint_of(self.trials, group)
        found = self._found(folder, group.first)
        claims = (
            replace(claim, expected=Verdict.VIOLATED) if claim == complaint.claim else claim
            for claim in found.claims
        )
        origin = origin_of(self.trials, group.first, findings.searcher)
        head = [f"As found, not shrunk: {complaint.sentence}", *origin]
        comments = "".join(f"# {line}\n" for line in head)
        text = comments + "\n" + write_scenario(replace(found, claims=tuple(claims)))
        self._write(self._file(folder, complaint, number + 1), text)

    def _write(self, path: Path, text: str) -> bool:
        if not self.keeps:
            return True
        try:
            if self.unwritable is None:
                write_text(path, text)
                return True
        except OutputError as error:
            self.unwritable = error
        self.output.result(f"# --- {path} (which could not be written)\n{text}# ---")
        return False


def search_space(
    trials: Trials,
    make: MakesSearcher,
    *,
    out: Path | None,
    budget: int,
    output: Output,
    baseline: bool = False,
    explain: Explain = unexplained,
) -> SearchSession:
    """Search, shrink, confirm, explain, and write findings to ``out``, if there is one, as they come.

    ``baseline`` samples the space uniformly as well, with the same budget, to compare with.  Raises
    InadmissibleError for a space of which next to no point can be tried.  Where PyBullet is not installed,
    findings are shrunk in the kinematic world, and all that is written says that nothing was confirmed.
    """
    there = PYBULLET.is_installed
    confirming = in_pybullet if there else in_kinematic
    session = SearchSession(trials, out or Path(), budget, output, confirming, there, explain)
    session.keeps = out is not None
    at = session.out
    files = [*at.glob("*.yaml"), *(at / AS_FOUND).rglob("*.yaml")] if (at / FINDINGS).exists() else []
    if session.keeps and files:
        output.say(f"{out} keeps the files of an earlier search, {files[0].name} among them")
    if not there:
        output.say(NO_REFERENCE)
    session.findings = session.search(make, trials)
    if baseline and not session.findings.interrupted and session.unwritable is None:
        output.say("the baseline: uniform sampling with the same budget")
        anew = replace(trials, coverage=Coverage(), violations=Coverage())
        session.baseline = session.search(UniformSampling, anew, folder="baseline")
        session.findings.interrupted = session.baseline.interrupted
    session.conclude()
    return session


@contextmanager
def watching_search(budget: int, output: Output) -> Iterator[Callable[[Findings], None]]:
    """Yield what takes the findings after every batch, and shows how far the search is."""
    begun_s = time.monotonic()
    with output.block() as show:
        show([f"tried 0/{budget}"])
        yield lambda findings: show(
            [summary(findings, budget) + where(findings.tried, budget, begun_s), *nearest_lines(findings)]
        )


def complaint_of(trials: Trials, group: Group) -> Complaint:
    """What a group of violations or mishaps is about: a claim, what the avoider did, or why a run failed."""
    if group.claim is not None:
        return Complaint(trials.claims[group.claim], reference=trials.reference)
    claim = None if group.kind.startswith(RUN_FAILED) else trials.answered
    return Complaint(claim, group.kind, trials.reference)


def _one_of_each_kind_first(groups: Sequence[Group]) -> list[Group]:
    """The worst of each kind, then the others."""
    firsts: dict[str, Group] = {}
    for group in groups:
        firsts.setdefault(group.kind, group)
    return [*firsts.values(), *(group for group in groups if firsts[group.kind] is not group)]


def nearest_lines(findings: Findings) -> list[str]:
    """For each claim how near it came, and how often it was put to the test and violated."""
    lines = []
    for claim, goal in enumerate(findings.goals):
        nearest = findings.nearest[claim]
        near = "no margin yet" if nearest is None else goal.margin_text(float(nearest.margins[claim]))
        kept = f", and kept by {goal.against}," if goal.against else ""
        counts = f"violated{kept} {findings.violated[claim]} of {findings.evidence[claim]} with a verdict"
        lines.append(f"  {near:>14}  {goal.sentence}: {counts}")
    return lines


def not_found_words(findings: Findings) -> str:
    """That what a space expects to be violated was not, and what that may come from."""
    return (
        f"the space expects it to be violated, and of {findings.tried} runs none is known to do so; the "
        "system does better than the space says, or the budget is too small"
    )


def summary(findings: Findings, budget: int) -> str:
    """Tried, refused, found."""
    violations = sum(group.claim is not None for group in findings.groups)
    mishaps = len(findings.groups) - violations
    return (
        f"tried {findings.tried}/{budget}, refused {findings.refused.total()}, {violations} violations apart"
        + (f", {mishaps} kinds of mishap" if mishaps else "")
    )


def against_lines(against: Against, findings: Findings, touching: int, overruled: str) -> list[str]:
    """How the runs differ from the reference's, and what it is worth that none is worse."""
    lines = [f"against {against.reference}: {line}" for line in against.lines()]
    if findings.tried and not (findings.found or overruled):
        touch = f"; in {touching} of them a hand touched the arm" if touching else ""
        lines.append(
            f"nothing found that {against.reference} does not do as well, in {findings.tried} runs{touch}. A "
            "search estimates nothing: that is no evidence of safety in the rest of the space"
        )
    return lines


def remarks(trials: Trials, findings: Findings, overruled: str = "") -> list[str]:
    """What a reader would otherwise get wrong; ``overruled``: that the gate overrules more than before."""
    lines = [f"{count} points refused: {reason}" for reason, count in findings.refused.most_common(3)]
    for claim, goal in enumerate(findings.goals):
        if trials.of_others[claim]:
            lines.append(f"not applicable to the controller: {goal.sentence}")
        elif findings.always_violated(claim):
            lines.append(f"every run violates {goal.sentence!r}: it is the claim or the space, no corner")
        elif findings.tried and not findings.evidence[claim]:
            lines.append(f"no run put {goal.sentence!r} to the test: nothing is known of it")
        elif (nearest := findings.nearest[claim]) is not None and trials.reference is None:
            words = far_words(close_to(trials.properties[claim]), float(nearest.margins[claim]))
            lines += [f"{goal.sentence}: {words}"] * bool(words)
    lines += trials.tried.lines(trials.space)
    touching = trials.coverage.touching
    if np.isfinite(trials.nearest_hand_m):
        near = Unit.LENGTH.margin_text(trials.nearest_hand_m)
        lines.append(f"nearest hand: {near}; in {touching} of {findings.tried} runs a hand touched the arm")
    if trials.against is not None:
        lines += against_lines(trials.against, findings, touching, overruled)
    elif not findings.found and touching:
        lines.append(
            "no claim was violated: none here says that a hand must not touch the arm (--claim 'hand "
            "distance never below 1 mm' searches for that)"
        )
    elif not findings.found and findings.tried:
        lines.append(
            f"nothing found in {findings.tried} runs. A search estimates nothing: that is no evidence of "
            "safety in the rest of the space"
        )
    lines.append("coverage: " + str(trials.coverage).replace("\n", "\n  "))
    return lines
