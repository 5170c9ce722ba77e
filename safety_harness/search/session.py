"""Search a space for violations, then shrink, confirm, explain and write each violation.

The session writes each finding at once, before shrinking, so that no later failure loses it. After the
search, the session shrinks the worst groups of each claim. For each claim, shrinking stops after six groups
or three different structures.
"""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

from safety_harness.admission.admit import Admitter
from safety_harness.admission.avoiders import as_seen_from
from safety_harness.admission.repeatability import RepeatabilityResult
from safety_harness.admission.trial import run_all
from safety_harness.base.compiling import Pace
from safety_harness.base.exceptions import OutputError, explanation
from safety_harness.base.output import Output, where
from safety_harness.base.seeds import Branch
from safety_harness.base.seeds import seed as leaf
from safety_harness.base.whole_file import write_text, writing
from safety_harness.cell.simulation.worlds import KINEMATIC, WorldEntry, references
from safety_harness.claims.properties.answered import fallback_words
from safety_harness.claims.properties.tally import short_basis
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.write import write_scenario
from safety_harness.search.confirm import Complaint, Confirm, Disagreement, disagreement_of, physics_of
from safety_harness.search.counterexample import (
    Allowance,
    Counterexample,
    Explain,
    cost_s,
    counterexample_of,
    origin_of,
    text_of,
    unexplained,
)
from safety_harness.search.coverage import Coverage
from safety_harness.search.cube import Cube
from safety_harness.search.findings import RUN_FAILED, Findings, Group, TriedPoint
from safety_harness.search.redrawn import keep_differences, more_overruled, worse_answers
from safety_harness.search.result_lines import (
    basis_of_search,
    counted,
    nearest_lines,
    not_found_words,
    nothing_confirmed,
    remarks,
    summary,
)
from safety_harness.search.sampling import UniformSampling
from safety_harness.search.search import find_violations
from safety_harness.search.searchers import MakesSearcher
from safety_harness.search.shrink import SpentError
from safety_harness.search.trials import InWorld, ScenarioRunner, Trials, world_of
from safety_harness.search.written import Causes, WrittenCounterexample
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace

FINDINGS, AS_FOUND = "findings.json", "as-found"
MOST_SHRUNK = 3  # counterexamples of each claim, and of run errors
SHRINKING_RUNS = 200  # for each counterexample
AN_EXAMPLE = 40  # an example costs about as much as so many runs of the space
MOST_RUN_TWICE = 8  # disagreements of the worlds that the page shows with both runs
_MOST_AS_FOUND = 1_000  # files
LEAST_DRAWN = 300  # pairs of runs anywhere in the space; with fewer, a share of 3 % may be chance
_BATCH = 64  # runs that are simulated together


def _report_at(report: Callable[[str], None], where: str, message: str) -> None:
    report(f"{where}: {message}")


@dataclass(eq=False)
class SearchSession:
    """One search of a space with its findings.

    If the session cannot write a finding to a file, it prints the finding. ``baseline`` holds the findings of
    uniform sampling with the same budget. ``references`` are the installed worlds that confirm results.
    ``confirmed`` counts the findings that all these worlds show. If there is no reference, the findings are
    shrunk in the searched world, and ``confirmed`` stays 0. ``unwritable`` is the error because of which the
    session stopped writing files. The session calls ``explain`` to explain each violation. ``repeated``
    compares the avoider's answers with the answers of a second instance, or is None without this comparison.
    ``flips`` lists lines on differences from the reference avoider that new draws did not reproduce.
    ``worse`` lists sentences on weaknesses of the avoider, compared with the reference, that violate no
    claim. Such weaknesses are refused proposals, wrong answers and late answers. If ``explains_all`` is
    False, ``allowance`` limits the simulated time of the explanations to that of the search. ``examples``
    holds the violations of each claim. The session calls ``concluding`` after the search. ``admitter`` admits
    the runs that confirm, shrink and explain. ``keeps`` states whether the session writes findings to
    ``out``.
    """

    trials: Trials
    out: Path
    budget: int
    output: Output
    references: tuple[WorldEntry, ...] = ()
    explain: Explain = unexplained
    explains_all: bool = True
    concluding: Callable[[SearchSession], None] = lambda session: None
    findings: Findings = field(init=False)
    baseline: Findings | None = None
    written: list[WrittenCounterexample] = field(default_factory=list)
    confirmed: int = 0
    physical: int = 0
    unwritable: OutputError | None = None
    unconfirmed: list[Disagreement] = field(default_factory=list)
    repeated: RepeatabilityResult | None = None
    flips: list[str] = field(default_factory=list)
    worse: list[str] = field(default_factory=list)
    keeps: bool = True
    allowance: Allowance = field(default_factory=Allowance)
    examples: list[_Examples] = field(default_factory=list)
    admitter: Admitter = field(default_factory=Admitter)

    @property
    def searched(self) -> WorldEntry:
        """The searched world."""
        return world_of(self.trials.world)

    @property
    def unconfirmable(self) -> str:
        """The reason why no finding is confirmed, or an empty text if a reference is installed."""
        return "" if self.references else nothing_confirmed(self.searched)

    @property
    def confirming(self) -> ScenarioRunner:
        """The runner that confirms findings.

        The world of this runner is the first reference. If there is no reference, it is the searched world.
        """
        return InWorld(next(iter(self.references), self.searched))

    @property
    def _confirming_words(self) -> str:
        """A text that lists the worlds in which findings are repeated.

        If there is no reference, findings are repeated in the searched world.
        """
        return " and ".join(map(str, self.references)) or str(self.searched)

    @property
    def confirmed_in(self) -> tuple[str, ...]:
        """The worlds that confirm findings.

        The result is empty if no finding is confirmed.
        """
        return tuple(map(str, self.references if self.confirmed else ()))

    @property
    def causes(self) -> Causes:
        """The causes of the examples.

        If a file has several causes, it is listed only under the cause that most files share.
        """
        left = [(cause, written.path.name) for written in self.written for cause in written.one.causes]
        explained: dict[str, list[str]] = {}
        while left:
            ((cause, _),) = Counter(cause for cause, _ in left).most_common(1)
            explained[cause] = [name for known, name in left if known == cause]
            left = [(known, name) for known, name in left if name not in explained[cause]]
        unknown = [written for written in self.written if not written.one.causes]
        tried = sum(len(written.groups) for written in unknown if written.one.attribution)
        count = sum(len(written.groups) for written in unknown)
        if not self.explains_all or self.interrupted:  # else the others are attributed without shrinking
            count += sum(len(example.left) for example in self.examples)
        return Causes(explained, count, 0 if self.explains_all else count - tried)

    @property
    def summary(self) -> str:
        """The numbers of causes, violations and runs."""
        violations = f"{counted(int(self.findings.violated.sum()))} in {self.findings.tried:,} runs"
        return f"{self.causes.summary}; {violations}" if self.written else violations

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the search."""
        return self.findings.interrupted

    @property
    def not_found(self) -> list[str]:
        """The claims that no confirmed counterexample violates, although the space expects a violation."""
        missing = self.trials.to_be_found - {written.one.complaint.sentence for written in self.written}
        goals = zip(self.trials.goals, self.trials.of_others, strict=True)
        return [goal.sentence for goal, of_others in goals if goal.sentence in missing and not of_others]

    @property
    def differs(self) -> bool:
        """Whether the result differs from the expectations of the space, or this could not be decided."""
        applicable = ~self.trials.of_others  # all other claims cannot be judged
        unknown = bool(self.findings.tried) and not applicable.any()
        unknown |= not self.findings.evidence[applicable].all()  # a claim that no run exercised
        unknown |= bool(self.worse or self.not_found)
        return unknown or not all(written.expected for written in self.written)

    def search(self, make: MakesSearcher, trials: Trials, folder: str | None = "") -> Findings:
        """Search until the budget is spent, the user presses Ctrl-C, or a file cannot be written.

        Args:
            make: The searcher's factory.
            trials: The trials of the space.
            folder: The folder below ``as-found`` for unshrunk findings. If it is None, no finding is saved.

        """
        cube = Cube.from_space(trials.space)
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
        """Report the findings of the search and, unless it was interrupted, shrink and explain them."""
        findings, say = self.findings, self.output.say
        fallback = fallback_words(self.trials.unanswered, self.trials.decisions)
        self._draw_again()
        self.examples = self._examples_of_claims()
        whole = summary(findings, self.budget) + (f"; {fallback}" if fallback else "")
        overruled = filter(None, [self.trials.overruling.summary])
        lines = [*self.trials.space.notes, whole, *overruled, *nearest_lines(findings)]
        self.concluding(self)
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
            say("interrupted: the findings are kept as found, not shrunk")
        elif self.unwritable is None:
            self._explain_groups()
        for line in remarks(self.trials, findings, self.worse):
            say(line)
        self.output.detail("coverage: " + str(self.trials.coverage).replace("\n", "\n  "))
        whole_basis = basis_of_search(findings, self.searched, self.confirmed_in)
        say(short_basis(whole_basis))
        self.output.detail(whole_basis)
        for sentence in [] if findings.interrupted else self.not_found:
            self.output.result(f"NOT FOUND  {sentence}: {not_found_words(findings)}")
        if self.written and self.unconfirmable:
            say(self.unconfirmable)
        if self.confirmed:
            repeated = f"repeated in {self._confirming_words}: {counted(self.confirmed, 'finding')}"
            say(f"{repeated}; physics had a part in {self.physical}")
        if self.unconfirmed:
            count = f"{len(self.unconfirmed)} findings were not confirmed in {self._confirming_words}"
            say(f"{count}; they are in {FINDINGS}")

    def last_lines(self, unwritable: OutputError | None) -> list[str]:
        """Return the lines that end the output of the search.

        They state the command that runs the counterexamples again, and the error of a failed write.
        """
        lines = []
        if self.written:
            again = ["safety-harness", "run", *(str(written.path) for written in self.written)]
            reference = self.trials.reference
            again += [] if reference is None else ["--against", reference.name]
            again += [] if self.references else ["--world", self.searched.label]
            lines.append(f"next: {shlex.join(again)}    (they run as they say)")
        return lines + ([] if unwritable is None else [f"error: {explanation(unwritable)}"])

    def moved_to(self, folder: Path) -> SearchSession:
        """Return the session with its findings in ``folder``.

        Findings that ``folder`` lacks are written first.
        """
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
            case, run = old.one, old.one.run
            if isinstance(run, Trace):
                run = replace(run, scenario=replace(as_seen_from(folder, run.scenario), file=file))
            scenario = replace(as_seen_from(folder, case.shrunk.scenario), file=file)
            case = replace(case, run=run, shrunk=replace(case.shrunk, scenario=scenario))
            moved._save(case, old.groups, old.searcher)
        return moved

    @cached_property
    def _drawn(self) -> Trials:
        """The trials at uniformly drawn points.

        The number of points equals the budget of the search, but is at least ``LEAST_DRAWN``.
        """
        self.output.say("runs anywhere in the space with both, to hold what was found against")
        own = leaf(self.trials.seed, Branch.SEARCH, 6)
        drawn = replace(self.trials, seed=own, coverage=Coverage(), violations=Coverage())
        if self.search(UniformSampling, drawn, folder=None).interrupted:
            raise KeyboardInterrupt
        return drawn

    def _draw_again(self) -> None:
        """Draw the differences from the reference avoider again, unless the search was interrupted."""
        try:
            for findings in filter(None, [self.findings, self.baseline] if not self.interrupted else []):
                self.flips += keep_differences(self.trials, findings, lambda: self._drawn)
            if not self.interrupted:
                for worse in (more_overruled, worse_answers):
                    self.worse += worse(self.trials, lambda: self._drawn)
        except KeyboardInterrupt:
            self.findings.interrupted = True
        for line in self.flips:
            self.output.say(f"flips near the limit: {line}")
        for line in self.worse:
            self.output.result(f"WORSE  {line}")

    def _ask_again(self) -> None:
        """Compare the avoider's answers with those of a second instance, except after an interruption."""
        if not self.interrupted:
            self.repeated = self.trials.repeatability.reported(self.output)
            self.findings.interrupted = self.repeated is None

    def _origin(self, group: Group, searcher: str) -> list[str]:
        """Return lines on the origin of ``group``.

        If the avoider or the confirmation is doubtful, the first lines state this.
        """
        doubt = [self.repeated.line] if self.repeated is not None and self.repeated.words else []
        doubt += [self.unconfirmable] if self.unconfirmable else []
        return [*doubt, *origin_of(self.trials, group.worst, searcher)]

    @property
    def _searches(self) -> list[Findings]:
        """The findings of the search and, if there was a baseline, the findings of the baseline."""
        return [self.findings] if self.baseline is None else [self.findings, self.baseline]

    def _examples_of_claims(self) -> list[_Examples]:
        """Return the violations of each claim.

        If the search found no violation of a claim, the violations that the baseline found are used.
        """
        examples = []
        for claim in (*range(len(self.findings.goals)), None):
            findings = next((search for search in self._searches if search.of_claim(claim)), self.findings)
            if groups := _one_of_each_kind_first(findings.of_claim(claim)):
                examples.append(_Examples(self, claim, findings, groups))
        return examples

    def _explain_groups(self) -> None:
        """Shrink and explain one violation of each claim, then further violations while the allowance lasts.

        If ``explains_all`` is False, a further violation becomes an example only if its cause is new.
        """
        examples = self.examples
        each_s = cost_s(self.searched, [self.trials.space.simplest])
        if not self.explains_all:
            self.allowance.total_s = each_s * sum(search.tried for search in self._searches)
        an_example_s = AN_EXAMPLE * each_s
        going = []
        with self.output.messages() as report:
            for example in examples:
                self.allowance.share(last=example is examples[-1], least_s=an_example_s)
                going += [example] if example.explain_next(report) else []
            self.allowance.share(last=True)
            while going:
                affordable = self.allowance.has(an_example_s)
                going = [
                    example
                    for example in going
                    if (example.claim is None or affordable) and example.explain_next(report)
                ]
        if self.written:
            self.output.result(f"VIOLATED  {self.summary}")
        for written in self.written:
            self.output.result(*written.lines)
            self.output.detail(*(f"  {line}" for line in written.one.further))
        for cause, files in self.causes.explained.items():
            if len(files) > 1:
                self.output.say(f"one cause of {len(files)} examples: {cause}: {', '.join(files)}")

    def _counterexample(
        self, group: Group, number: int, on_step: Callable[[str], None]
    ) -> Counterexample | None:
        """Return the shrunk counterexample of a group, or None if no run of the group is confirmed."""
        complaint = complaint_of(self.trials, group)
        path = self._file(self.out, complaint, number)
        case = None
        for episode in (group.worst, *group.others):
            scenario = replace(self._scenario_of(self.out, episode), file=path, name=path.stem)
            try:
                case = counterexample_of(
                    scenario,
                    complaint,
                    self.confirming,
                    budget=SHRINKING_RUNS,
                    sooner=self.trials.world if self.references else None,
                    explain=self.explain,
                    allowance=self.allowance,
                    admitter=self.admitter,
                    on_step=on_step,
                )
            except KeyboardInterrupt:
                self.findings.interrupted = True
                return None
            if case is not None:
                group.worst = episode
                break
        if case is None:
            self._keep_unconfirmed(group, complaint, scenario, self.confirming)
            where = f"{complaint.sentence}, point {group.worst.number}"
            self.output.say(f"not confirmed in {self._confirming_words}: {where}")
            return None
        for world in self.references[1:]:
            if not Confirm(complaint, InWorld(world), admit=self.admitter.admit_afresh)(case.shrunk.scenario):
                self._keep_unconfirmed(group, complaint, case.shrunk.scenario, InWorld(world))
                worlds = f"{self.references[0]} shows this, {world} does not"
                self.output.result(f"REFERENCES DISAGREE  {complaint.sentence}: {worlds}")
                return None
        self.findings.interrupted |= case.shrunk.interrupted
        return self._with_physics(case) if self.references else case

    def _with_physics(self, case: Counterexample) -> Counterexample:
        """Count a confirmed case, and return the case with an additional line.

        The line states whether physics influenced the run.
        """
        admitted = self.admitter.admit_afresh(case.shrunk.scenario)
        (model,) = run_all([admitted], KINEMATIC)  # which refuses rendered images
        had_part, sentence = physics_of(case.run, model)
        self.confirmed, self.physical = self.confirmed + 1, self.physical + had_part
        line = f"repeated in {self._confirming_words}; {sentence}"
        return replace(case, circumstances=(*case.circumstances, line))

    def _keep_unconfirmed(
        self, group: Group, complaint: Complaint, scenario: Scenario, world: ScenarioRunner
    ) -> None:
        """Store a finding that a reference does not show.

        The first such findings include their runs in both worlds.
        """
        self.unconfirmed.append(
            disagreement_of(group, complaint, scenario, self.trials.world, world)
            if len(self.unconfirmed) < MOST_RUN_TWICE
            else Disagreement(group, complaint)
        )

    def _file(self, folder: Path, complaint: Complaint, number: int) -> Path:
        """Return the path in ``folder`` for counterexample number ``number`` of ``complaint``."""
        stem = re.sub(r"[^a-z0-9]+", "-", complaint.sentence.lower()).strip("-")[:60].rstrip("-")
        return folder / f"{self.trials.space.name}-{stem}-{number}.yaml"

    def _scenario_of(self, folder: Path, episode: TriedPoint) -> Scenario:
        """Return the scenario of a tried point.

        The paths in the scenario are relative to ``folder``.
        """
        return as_seen_from(folder, self.trials.scenario(episode.point, episode.number))

    def _save(self, case: Counterexample, groups: list[Group], searcher: str) -> WrittenCounterexample:
        """Write a counterexample with its trace, and add it to ``written``."""
        path = case.shrunk.scenario.file
        assert path is not None
        trace_file = path.with_suffix(".trace") if isinstance(case.run, Trace) else None
        text = text_of(case, self._origin(groups[0], searcher), trace_file)
        if self._write(path, text) and self.keeps and isinstance(case.run, Trace) and trace_file is not None:
            try:
                with writing(trace_file):
                    save_trace(case.run, trace_file)
            except OutputError as error:
                self.unwritable = error
        expected = case.complaint.claim is not None and case.complaint.sentence in self.trials.to_be_found
        self.written.append(WrittenCounterexample(case, groups, searcher, path, trace_file, text, expected))
        return self.written[-1]

    def _save_as_found(self, group: Group, folder: Path, number: int, findings: Findings) -> None:
        """Write a group's first run at once, before shrinking, so that no later failure loses it."""
        complaint = complaint_of(self.trials, group)
        scenario = self._scenario_of(folder, group.first)
        claims = (
            replace(claim, expected=Verdict.VIOLATED) if claim == complaint.claim else claim
            for claim in scenario.claims
        )
        origin = origin_of(self.trials, group.first, findings.searcher)
        head = [f"As found, not shrunk: {complaint.sentence}", *origin]
        comments = "".join(f"# {line}\n" for line in head)
        text = comments + "\n" + write_scenario(replace(scenario, claims=tuple(claims)))
        self._write(self._file(folder, complaint, number + 1), text)

    def _write(self, path: Path, text: str) -> bool:
        """Write ``text`` to ``path``. If this fails, print the text.

        Return False if the text was printed.
        """
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


@dataclass(eq=False)
class _Examples:
    """The examples of violations of ``claim``, or the examples of run errors if ``claim`` is None.

    ``left`` lists the groups that still need an explanation, and ``written`` lists the examples written
    before.
    """

    session: SearchSession
    claim: int | None
    findings: Findings
    left: list[Group]
    written: list[WrittenCounterexample] = field(default_factory=list)
    shrunk: int = 0

    def _has_an_example(self, group: Group) -> bool:
        """Return whether the worst run of ``group`` has the cause of a written example.

        To compare the causes, the function explains the run in the form that the search found, without
        shrinking it.
        """
        session, causes = self.session, {cause for written in self.written for cause in written.one.causes}
        if session.explains_all or not causes:
            return False
        if self.claim is None:
            return group.kind in causes
        claim = session.trials.claims[self.claim]
        worst = session._scenario_of(session.out, group.worst)
        explanation = session.explain(worst, claim, session.allowance, confirms=False)
        return not causes.isdisjoint(explanation.causes)

    def explain_next(self, report: Callable[[str], None]) -> bool:
        """Explain the next violation that the confirming world shows.

        Return False if there is no such violation.
        """
        session = self.session
        while self.left and len(self.written) < MOST_SHRUNK and self.shrunk < 2 * MOST_SHRUNK:
            if session.findings.interrupted:
                break
            group = self.left[0]
            try:
                if self._has_an_example(group):
                    del self.left[0]
                    return True
            except SpentError:
                break
            except KeyboardInterrupt:
                session.findings.interrupted = True
                break
            at = f"{self.findings.sentence_of(group)}, example {self.shrunk + 1}"
            case = session._counterexample(group, len(self.written) + 1, partial(_report_at, report, at))
            if case is None and session.findings.interrupted:
                break
            del self.left[0]
            if case is None:
                continue
            self.shrunk += 1
            if (
                same := next((written for written in self.written if case.is_same_as(written.one)), None)
            ) is not None:
                same.groups.append(group)
            else:
                self.written.append(session._save(case, [group], self.findings.searcher))
            return True
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
    explains_all: bool = True,
    admitter: Admitter | None = None,
    concluding: Callable[[SearchSession], None] = lambda session: None,
) -> SearchSession:
    """Search a space, then shrink, confirm, explain and write the findings.

    If no reference world other than the searched world is installed, the output states that no finding is
    confirmed.

    Args:
        trials: The trials of the space.
        make: The searcher's factory.
        out: The folder in which each finding is written at once. If it is None, no files are written.
        budget: The number of runs.
        output: The ``Output`` that receives lines and progress.
        baseline: Whether to sample the space also uniformly for comparison, with the same budget.
        explain: The function that explains a violation.
        explains_all: Whether to explain all violations. Otherwise, explanations take at most as much
            simulated time as the search.
        admitter: The admitter of all runs after the search. The default is a new admitter.
        concluding: The function that receives the session after the search and before the first explanation.

    Returns:
        The session.

    Raises:
        InadmissibleError: Admission refuses almost every point of the space.

    """
    candidates = (world for world in references() if world.name != world_of(trials.world).name)
    able = tuple(world for world in candidates if world.makes_images_of(trials.space.simplest))
    session = SearchSession(trials, out or Path(), budget, output, able, explain, explains_all, concluding)
    session.keeps = out is not None
    session.admitter = admitter or session.admitter
    at = session.out
    files = [*at.glob("*.yaml"), *(at / AS_FOUND).rglob("*.yaml")] if (at / FINDINGS).exists() else []
    if session.keeps and files:
        output.say(f"{out} keeps the files of an earlier search, {files[0].name} among them")
    if session.unconfirmable:
        output.say(session.unconfirmable)
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
    """Yield a function that receives the findings after each batch and shows the progress.

    Args:
        budget: The number of runs.
        output: The ``Output`` that shows the progress.

    """
    pace = Pace()
    with output.block() as show:
        show([f"tried 0/{budget}"])
        yield lambda findings: show(
            [summary(findings, budget) + where(findings.tried, budget, pace), *nearest_lines(findings)]
        )


def complaint_of(trials: Trials, group: Group) -> Complaint:
    """Return the complaint of ``group``: a violated claim, an avoider's fault, or a run's failure."""
    if group.claim is not None:
        return Complaint(trials.claims[group.claim], reference=trials.reference)
    claim = None if group.kind.startswith(RUN_FAILED) else trials.answered
    return Complaint(claim, group.kind, trials.reference)


def _one_of_each_kind_first(groups: Sequence[Group]) -> list[Group]:
    """Return ``groups`` in a new order, which begins with the worst group of each kind."""
    firsts: dict[str, Group] = {}
    for group in groups:
        firsts.setdefault(group.kind, group)
    return [*firsts.values(), *(group for group in groups if firsts[group.kind] is not group)]
