"""``safety-harness fuzz``: search a space for violations, shrink, confirm, explain and write them down."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from safety_harness.admission.elsewhere import as_seen_from
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED, explain, result, say
from safety_harness.cli.fuzz_json import as_json, complaint_of
from safety_harness.cli.fuzz_progress import FuzzProgress, nearest_lines, summary
from safety_harness.cli.show import write_text
from safety_harness.exceptions import InputError, OutputError, Place, ScenarioError
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.write import write_scenario
from safety_harness.search.counterexample import Counterexample, counterexample_of, origin_of, text_of
from safety_harness.search.cube import Cube
from safety_harness.search.findings import Episode, Findings, Group
from safety_harness.search.search import search
from safety_harness.search.searchers import SEARCHERS, MakesSearcher
from safety_harness.search.trials import Trials, World, in_kinematic, in_pybullet
from safety_harness.space.read import read_space
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace

FINDINGS, AS_FOUND = "findings.json", "as-found"
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
) -> int:
    """Search, shrink, confirm, explain, write; returns the exit code."""
    try:
        if budget < 1:
            raise ScenarioError(place=Place(field="--budget"), expected="at least 1 run", got=str(budget))
        make = _searcher(searcher)
        trials = Trials(read_space(file), in_kinematic, seed=seed, avoider=avoider, sentences=tuple(claims))
        session = _Session(trials, out, make, budget)
        session.search()
        session.conclude()
    except InputError as error:
        explain(error)
        return BAD_INPUT
    except KeyboardInterrupt:
        say("interrupted before anything was tried")
        return INTERRUPTED
    return session.exit_code


def _searcher(name: str) -> MakesSearcher:
    for make in SEARCHERS:
        if make.name == name:
            return make
    names = ", ".join(make.name for make in SEARCHERS)
    raise ScenarioError(place=Place(field="--searcher"), expected=f"one of {names}", got=repr(name))


@dataclass(eq=False)
class _Session:
    """One search and what becomes of its findings.  What cannot be written is printed instead."""

    trials: Trials
    out: Path
    make: MakesSearcher
    budget: int
    confirming: World = in_pybullet
    written: list[tuple[Counterexample, Path]] = field(default_factory=list)
    unwritable: OutputError | None = None
    unconfirmed: list[Group] = field(default_factory=list)

    def search(self) -> None:
        """Until the budget is spent, Ctrl-C, or a disk that takes no more."""
        cube = Cube.of(self.trials.space)
        searcher = self.make(cube, claims=len(self.trials.goals), seed=self.trials.seed)
        self.findings = Findings(self.trials.goals, cube, searcher.name)
        progress = FuzzProgress(self.budget)
        saved = 0

        def keep(findings: Findings) -> None:
            nonlocal saved
            self.findings = findings
            for group in findings.groups[saved:_MOST_AS_FOUND]:
                self._save_as_found(group, saved)
                saved += 1
            progress.show(findings)

        with progress.running():
            self.findings = search(
                cube,
                self.trials.goals,
                self.trials,
                searcher,
                budget=self.budget,
                batch=_BATCH,
                on_progress=keep,
                enough=lambda findings: self.unwritable is not None,
            )

    def conclude(self) -> None:
        """Shrink and report, unless the search was interrupted."""
        findings = self.findings
        for line in (*self.trials.space.notes, summary(findings, self.budget), *nearest_lines(findings)):
            say(line)
        if findings.interrupted:
            say("interrupted: what was found is kept as it was found, not shrunk")
        elif self.unwritable is None:
            for claim in (*range(len(findings.goals)), None):
                self._shrink_groups(claim)
        self._save_findings()
        for line in self._remarks():
            say(line)
        if self.unwritable is not None:
            explain(self.unwritable)

    def _shrink_groups(self, claim: int | None) -> None:
        kept: list[Counterexample] = []
        shrunk = 0
        for group in _one_of_each_kind_first(self.findings.of_claim(claim)):
            if len(kept) == _MOST_SHRUNK or shrunk == 2 * _MOST_SHRUNK or self.findings.interrupted:
                return
            one = self._counterexample(group, len(kept) + 1)
            shrunk += one is not None
            if one is None or any(one.is_same_as(other) for other in kept):
                continue
            kept.append(one)
            self._save(one, group)

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
            self.unconfirmed.append(group)
            say(f"not confirmed in PyBullet: {complaint.sentence}, point {group.worst.number}")
        elif one.shrunk.interrupted:
            self.findings.interrupted = True
        return one

    def _found(self, episode: Episode) -> Scenario:
        return as_seen_from(self.out, self.trials.scenario(episode.point, episode.number))

    def _origin(self, episode: Episode) -> list[str]:
        trials = self.trials
        return origin_of(trials.space, episode.point, episode.number, trials.seed, self.make.name)

    def _save(self, one: Counterexample, group: Group) -> None:
        path = one.shrunk.scenario.file
        assert path is not None
        trace_file = path.with_suffix(".trace") if isinstance(one.run, Trace) else None
        text = text_of(one, self._origin(group.worst), trace_file)
        if self._write(path, text) and isinstance(one.run, Trace) and trace_file is not None:
            try:
                save_trace(one.run, trace_file)
            except OSError as error:
                self.unwritable = OutputError.of(trace_file, error)
        self.written.append((one, path))
        result(f"violated {_margin_of(one):>13}  {one.complaint.sentence}")
        result(f"  {path}: {group.count} runs near it; shrunk in {one.shrunk.used} runs")
        for line in one.explanation:
            result(f"  {line}")

    def _save_as_found(self, group: Group, number: int) -> None:
        """At once, so that nothing that happens later loses it."""
        complaint = complaint_of(self.trials, group)
        path = self.out / AS_FOUND / f"{self.trials.space.name}-{_slug(complaint.sentence)}-{number + 1}.yaml"
        found = as_seen_from(path.parent, self.trials.scenario(group.first.point, group.first.number))
        claims = (
            replace(claim, expected=Verdict.VIOLATED) if claim == complaint.claim else claim
            for claim in found.claims
        )
        head = [f"As found, not shrunk: {complaint.sentence}", *self._origin(group.first)]
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

    def _save_findings(self) -> None:
        if self.unwritable is None:
            try:
                counterexamples = [path for _, path in self.written]
                found = as_json(self.trials, self.findings, self.budget, self.unconfirmed, counterexamples)
                write_text(self.out / FINDINGS, json.dumps(found, indent=1) + "\n")
            except OutputError as error:
                self.unwritable = error

    def _remarks(self) -> list[str]:
        """What a reader would otherwise get wrong."""
        findings = self.findings
        lines = [f"{count} points refused: {reason}" for reason, count in findings.refused.most_common(3)]
        for claim, goal in enumerate(findings.goals):
            if findings.always_violated(claim):
                lines.append(f"every run violates {goal.sentence!r}: it is the claim or the space, no corner")
            elif findings.tried and not findings.evidence[claim]:
                lines.append(f"no run put {goal.sentence!r} to the test: nothing is known of it")
        if self.unconfirmed:
            lines.append(
                f"{len(self.unconfirmed)} findings were not confirmed in PyBullet; they are in {FINDINGS}"
            )
        if not findings.found and findings.tried:
            lines.append(
                f"nothing found in {findings.tried} runs. A search estimates nothing: that is no evidence of "
                "safety in the rest of the space"
            )
        lines.append("coverage: " + str(self.trials.coverage).replace("\n", "\n  "))
        command = ["safety-harness", "run", *(str(path) for _, path in self.written)]
        if self.written:
            lines.append("again: " + shlex.join(command))
        return lines

    @property
    def exit_code(self) -> int:
        """0 nothing that was confirmed, 1 something, 2 not all could be written, 130 interrupted."""
        if self.unwritable is not None:
            return BAD_INPUT
        if self.findings.interrupted:
            return INTERRUPTED
        return DIFFERS if self.written else AS_EXPECTED


def _one_of_each_kind_first(groups: Sequence[Group]) -> list[Group]:
    """The worst of each kind, then the others."""
    firsts: dict[str, Group] = {}
    for group in groups:
        firsts.setdefault(group.kind, group)
    return [*firsts.values(), *(group for group in groups if firsts[group.kind] is not group)]


def _margin_of(one: Counterexample) -> str:
    """The margin of the claim that it is a counterexample to; a dash for a mishap."""
    pairs = zip(one.shrunk.scenario.claims, one.evaluations, strict=False)
    return next(
        (evaluation.margin_text() for claim, evaluation in pairs if claim == one.complaint.claim), "-"
    )


def _slug(sentence: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", sentence.lower()).strip("-")[:60].rstrip("-")
