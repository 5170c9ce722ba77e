"""End a session: collect the judgements, count how often runs tested each claim, and write the report."""

from __future__ import annotations

import shlex
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from safety_harness.base.interrupts import answer_as_ctrl_c
from safety_harness.testing.session import session as current

if TYPE_CHECKING:
    from safety_harness.claims.properties.tally import ClaimTally
    from safety_harness.testing.plugin.payloads import EndedTest
    from safety_harness.testing.session import Judgement


class Ending:
    """The collector of all test results, including those of xdist's workers."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._sent: list[EndedTest] = []
        self._unwritten = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take over the judgements of a test from its report."""
        sent = vars(report).get("safety_harness")
        if sent is None:
            return
        from safety_harness.testing.plugin.payloads import of_text

        message = of_text(sent)
        run = message.run
        if run.judgements or message.simulated or message.swallowed or run.replayed or run.not_taken:
            hidden = message.failed and report.passed  # another plug-in's hook turned the failure into a pass
            self._sent.append(replace(message, swallowed=message.swallowed or hidden))

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Take over the names of files that an xdist worker ignored."""
        current().ignored += getattr(node, "workeroutput", {}).get("safety_ignored", [])

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self) -> None:
        """Let SIGTERM and SIGHUP end the session as Ctrl-C does, if the session has to write a report."""
        if current().report is not None:
            answer_as_ctrl_c()

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail a session in which some claim was never tested, and write the report."""
        nothing = self._not_taken() and not self._judgements()
        if (self._untested() or self._unjudged() or nothing) and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
        file = current().report
        if file is not None and self._sent:
            from safety_harness.testing.plugin.reporting import write_reports

            whole = session.exitstatus in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED)
            command = shlex.join(["pytest", *self._config.invocation_params.args])
            self._unwritten = write_reports(file, self._sent, self._tallies(), command=command, whole=whole)
            if self._unwritten and whole:
                session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print ignored files of other programs, the table of claims, the kept failures, and the seed."""
        if ignored := ", ".join(dict.fromkeys(current().ignored)):
            terminalreporter.write_line(
                f"safety-harness ignored {ignored}: a title as ours, and no key or no file that is ours"
            )
        if not self._sent:
            if (file := current().report) is not None and file.exists():
                terminalreporter.write_line(f"nothing was judged: {file} is of an earlier session", red=True)
            return
        from safety_harness.claims.properties.tally import far_lines, table_lines, untested_lines

        say = terminalreporter.write_line
        terminalreporter.section("safety claims")
        tallies = self._tallies()
        basis = [self._basis()] * bool(tallies)
        for line in (*table_lines(tallies), *far_lines(tallies), *self._tested(), *basis):
            say(line)
        untested = untested_lines(self._tallies())
        for line in untested and [
            *untested,
            "The session has failed: what is never exercised"
            f"{' or not measured' * any('not measured, and' in line for line in untested)} is no evidence.",
        ]:
            say(line, red=True)
        if self._unjudged():
            say(
                f"{self._unjudged()}; the session has failed: assert_holds(claim, trace) judges a run",
                red=True,
            )
        for sent in self._sent:
            if sent.swallowed:
                say(f"{sent.run.id} passed, although assert_holds failed in it", red=True)
        if self._fallback():
            say(self._fallback(), red=True)
        for line in (
            *self._against(),
            *self._not_taken(),
            *self._of_another(),
            self._overruled(),
            *self._computing_times(),
            *self._untried(),
            *self._remarks(),
            *self._world(),
        ):
            say(line)

    def _overruled(self) -> str:
        """Return a text on how often the gate overruled the avoiders.

        If several workers executed the same run, the run is included only once.
        """
        from safety_harness.trace.overruling import Overruling

        runs = {run: counts for sent in self._sent for run, counts in sent.run.overruled.items()}
        return sum(runs.values(), Overruling()).summary

    def _against(self) -> list[str]:
        """Return the differences from the reference.

        The lines contain p-values only if no test drew scenarios.
        """
        from safety_harness.admission.avoiders import told_avoider
        from safety_harness.claims.properties.against import Against
        from safety_harness.testing.plugin.payloads import differences

        now, runs = current(), differences(self._sent)
        if now.against is None or not runs:
            return []
        mine = "each file's own avoider" if now.avoider is None else told_avoider(now.avoider)
        drawn = not any(sent.run.draws for sent in self._sent)
        return list(Against(mine=mine, reference=told_avoider(now.against), runs=runs, drawn=drawn).lines())

    def _not_taken(self) -> list[str]:
        """Return how many tests were skipped because the avoider cannot take their scenarios."""
        avoiders = [sent.run.not_taken for sent in self._sent if sent.run.not_taken]
        return [
            f"not run: {avoiders.count(name)} tests of scenarios that {name} cannot take"
            for name in dict.fromkeys(avoiders)
        ]

    def _of_another(self) -> list[str]:
        """Return the violations that ``--avoider`` causes and that the file expects of its own avoider."""
        texts = dict.fromkeys(text for sent in self._sent for text in sent.run.of_another)
        return [f"expected of another than --avoider: it may be for another reason: {text}" for text in texts]

    def _computing_times(self) -> list[str]:
        from safety_harness.report.decisions import lines_of

        runs = (time for sent in self._sent for time in sent.run.computing_times)
        return [f"computing time: {line}" for line in lines_of(runs)]

    def _untried(self) -> list[str]:
        """Return the moves and faults that no run of the session exercised.

        A repeated run is included only once.
        """
        from safety_harness.claims.properties.tried import TriedParts

        tried = TriedParts()
        # A dictionary by run, because several tests may have judged the same run.
        for tried_run in {
            run: tried for sent in self._sent for run, tried in sent.run.tried.items()
        }.values():
            for title, of_run in tried_run.parts.items():
                tried.join(title, of_run)
        return tried.lines()

    def _remarks(self) -> list[str]:
        from safety_harness.testing.failure_text import nearest_path

        executed = dict.fromkeys(file for sent in self._sent for file in sent.executed)
        lines = [f"executed {file}" for file in executed]
        kept = [sent.run.kept for sent in self._sent if sent.run.kept]
        if kept:
            lines.append("scenarios of failures, tried first next time:")
            lines += [f"  {nearest_path(file)}" for file in kept]
        tried = [sent for sent in self._sent if sent.run.replayed]
        if tried:
            files = sum(len(sent.run.replayed) for sent in tried)
            passed = [file for sent in tried if not sent.failed for file in sent.run.replayed]
            lines.append(f"earlier failures tried first: {files}, in tests that pass now: {len(passed)}")
            lines += [f"  {nearest_path(file)}" for file in passed]
            as_kept = sum(len(sent.run.replayed) for sent in tried if sent.run.as_kept)
            lines += [f"  with the avoider of the file in which it is kept: {as_kept}"] if as_kept else []
        now = current()
        if any(sent.run.draws for sent in self._sent) and not now.derandomize:
            again = f"--hypothesis-seed={now.seed}"
            lines.append(f"profile {now.profile.name}; {again} draws the same scenarios again")
        if now.report is not None:
            lines.append(self._unwritten or f"report: {nearest_path(now.report)}")
        return lines

    def _world(self) -> list[str]:
        """Return a line for each world that was used by default.

        There are no lines if the session has chosen a world.
        """
        from safety_harness.cell.simulation.worlds import REFERENCE, WORLDS, defaulted

        made_in = {j.run.world for j in self._judgements()}
        named = [str(world) for world in WORLDS if world is not REFERENCE and str(world) in made_in]
        return [] if current().world else [defaulted(world) for world in named]

    def _fallback(self) -> str:
        """Return a text on how often the fallback acted, and in how many runs the avoider did not answer."""
        from safety_harness.claims.properties.answered import ANSWERED, fallback_words
        from safety_harness.report.words import count_words

        evaluations = {
            j.run: j.evaluation
            for j in self._judgements()
            if j.evaluation.sentence == ANSWERED.example and (j.evaluation.margin or 0.0) < 0.0
        }
        missing = sum(-int(evaluation.margin or 0.0) for evaluation in evaluations.values())
        text = fallback_words(missing, sum(evaluation.exercised for evaluation in evaluations.values()))
        return text and f"{text} of {count_words(len(evaluations), 'run', 'runs')}"

    def _unjudged(self) -> str:
        """Return a text on the simulated runs that no test judged.

        The text lists the tests that simulated these runs.
        """
        from safety_harness.report.words import count_words

        judged = {run for sent in self._sent for run in sent.judged}
        runs = {run: sent.run.id for sent in self._sent for run in {*sent.simulated} - judged}
        text = f"{count_words(len(runs), 'simulated run', 'simulated runs')} that nobody judged, in "
        return text * bool(runs) + ", ".join(dict.fromkeys(runs.values()))

    def _tested(self) -> list[str]:
        """Return a line on each tested system that is more than an avoider or controller with defaults.

        The line states the shield, the gate and the settings that differ from their defaults.
        """
        runs: dict[str, set[str]] = {}
        for run in (judgement.run for judgement in self._judgements()):
            runs.setdefault(run.beside, set()).add(run.name.partition("#")[0])
        return [f"tested in {', '.join(sorted(names))}: {text}" for text, names in runs.items() if text]

    def _tallies(self) -> tuple[ClaimTally, ...]:
        from safety_harness.testing.plugin.payloads import tallies_of

        return tallies_of(self._judgements())

    def _judgements(self) -> list[Judgement]:
        return [judgement for sent in self._sent for judgement in sent.run.judgements]

    def _basis(self) -> str:
        """Return the sentence on the basis of the session's verdicts."""
        from safety_harness.claims.properties.tally import basis_of_tallies

        return basis_of_tallies((j.run.world for j in self._judgements()), self._tallies())

    def _untested(self) -> list[str]:
        return [tally.sentence for tally in self._tallies() if tally.untested] if self._sent else []
