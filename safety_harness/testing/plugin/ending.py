"""The end of a session: what was judged, how often it was really tested, what was kept, the report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from safety_harness.testing.session import session as current

if TYPE_CHECKING:
    from safety_harness.claims.properties.tally import ClaimTally


class Ending:
    """Gathers what the reports of tests bring, from the workers of xdist too."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._sent: list[dict[str, Any]] = []
        self._unwritten = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take what a test judged."""
        sent = vars(report).get("safety_harness")
        if sent is not None and any(
            sent[what] for what in ("judged", "simulated", "swallowed", "replayed", "not_taken")
        ):
            sent["swallowed"] |= sent["failed"] and report.passed  # by a hook of somebody else's
            self._sent.append(sent)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Take what a worker of xdist ignored."""
        current().ignored += getattr(node, "workeroutput", {}).get("safety_ignored", [])

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """A session in which a claim was never put to the test has failed; write the report."""
        nothing = self._not_taken() and not any(sent["judged"] for sent in self._sent)
        if (self._untested() or self._unjudged() or nothing) and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
        file = current().report
        if file is not None and self._sent:
            from safety_harness.testing.plugin.reporting import write_reports

            whole = session.exitstatus in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED)
            self._unwritten = write_reports(
                file, self._sent, self._tallies(), config=self._config, whole=whole
            )
            if self._unwritten and whole:
                session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """The files of others; the table of claims, the kept failures, the seed."""
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
        found = self._tallies()
        basis = [self._basis()] * bool(found)
        for line in (*table_lines(found), *far_lines(found), *self._tested(), *basis):
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
            if sent["swallowed"]:
                say(f"{sent['test']} passed, although assert_holds failed in it", red=True)
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
        ):
            say(line)

    def _overruled(self) -> str:
        """How often the gate overruled the avoiders; each run counts once, whichever workers made it."""
        from safety_harness.trace.overruling import Overruling

        runs = {run: counts for sent in self._sent for run, counts in sent["overruled"].items()}
        return sum(map(Overruling.of_counts, runs.values()), Overruling()).words

    def _against(self) -> list[str]:
        """What the reference does not do; tested only if no test drew its scenarios."""
        from safety_harness.admission.avoiders import told_avoider
        from safety_harness.claims.properties.against import Against
        from safety_harness.testing.plugin.payloads import differences

        now, runs = current(), differences(self._sent)
        if now.against is None or not runs:
            return []
        mine = "each file's own avoider" if now.avoider is None else told_avoider(now.avoider)
        drawn = not any(sent["draws"] for sent in self._sent)
        return list(Against(mine=mine, reference=told_avoider(now.against), runs=runs, drawn=drawn).lines())

    def _not_taken(self) -> list[str]:
        """How many tests were skipped since an avoider cannot take their scenario."""
        avoiders = [sent["not_taken"] for sent in self._sent if sent["not_taken"]]
        return [
            f"not run: {avoiders.count(name)} tests of scenarios that {name} cannot take"
            for name in dict.fromkeys(avoiders)
        ]

    def _of_another(self) -> list[str]:
        """Violations that files expect of their own avoider, and --avoider has too."""
        found = dict.fromkeys(one for sent in self._sent for one in sent["of_another"])
        return [f"expected of another than --avoider: it may be for another reason: {one}" for one in found]

    def _computing_times(self) -> list[str]:
        from safety_harness.report.decisions import ComputingTime, lines_of
        from safety_harness.trace.answer_times import AnswersTook

        runs = (
            ComputingTime(name, words, AnswersTook(*times))
            for sent in self._sent
            for name, words, times in sent["computing"]
        )
        return [f"computing time: {line}" for line in lines_of(runs)]

    def _untried(self) -> list[str]:
        """The moves and faults that no run of the session tried; each run counts once."""
        from safety_harness.claims.properties.tried import TriedParts

        tried = TriedParts()
        for parts in {run: parts for sent in self._sent for run, parts in sent["tried"].items()}.values():
            for title, of_run in parts.items():
                tried.join(title, of_run)
        return tried.lines()

    def _remarks(self) -> list[str]:
        from safety_harness.testing.failure_text import near

        executed = dict.fromkeys(file for sent in self._sent for file in sent["executed"])
        lines = [f"executed {file}" for file in executed]
        kept = [Path(sent["kept"]) for sent in self._sent if sent["kept"]]
        if kept:
            lines.append("scenarios of failures, tried first next time:")
            lines += [f"  {near(file)}" for file in kept]
        tried = [sent for sent in self._sent if sent["replayed"]]
        if tried:
            files = sum(len(sent["replayed"]) for sent in tried)
            passed = [Path(file) for sent in tried if not sent["failed"] for file in sent["replayed"]]
            lines.append(f"earlier failures tried first: {files}, in tests that pass now: {len(passed)}")
            lines += [f"  {near(file)}" for file in passed]
            as_kept = sum(len(sent["replayed"]) for sent in tried if sent["as_kept"])
            lines += [f"  with the avoider of the file in which it is kept: {as_kept}"] if as_kept else []
        now = current()
        if any(sent["draws"] for sent in self._sent) and not now.derandomize:
            again = f"--hypothesis-seed={now.seed}"
            lines.append(f"profile {now.profile.name}; {again} draws the same scenarios again")
        if now.report is not None:
            lines.append(self._unwritten or f"report: {near(now.report)}")
        return lines

    def _fallback(self) -> str:
        """Of the runs in which the avoider did not answer: in how many decisions the fallback stood in."""
        from safety_harness.claims.properties.answered import ANSWERED, fallback_words
        from safety_harness.report.words import count_words
        from safety_harness.testing.plugin.payloads import judgements

        found = {
            j.run: j.evaluation
            for sent in self._sent
            for j in judgements(sent)
            if j.evaluation.sentence == ANSWERED.example and (j.evaluation.margin or 0.0) < 0.0
        }
        missing = sum(-int(one.margin or 0.0) for one in found.values())
        words = fallback_words(missing, sum(one.exercised for one in found.values()))
        return words and f"{words} of {count_words(len(found), 'run', 'runs')}"

    def _unjudged(self) -> str:
        """The simulated runs of which no test judged a claim, with the tests that made them."""
        from safety_harness.report.words import count_words

        judged = {run for sent in self._sent for run in sent["judged_runs"]}
        runs = {run: sent["test"] for sent in self._sent for run in {*sent["simulated"]} - judged}
        words = f"{count_words(len(runs), 'simulated run', 'simulated runs')} that nobody judged, in "
        return words * bool(runs) + ", ".join(dict.fromkeys(runs.values()))

    def _tested(self) -> list[str]:
        """What the verdicts are about, where anything but the avoider or controller is not the default."""
        from safety_harness.testing.plugin.payloads import judgements

        runs: dict[str, set[str]] = {}
        for run in (one.run for sent in self._sent for one in judgements(sent)):
            runs.setdefault(run.beside, set()).add(run.name.partition("#")[0])
        return [f"tested in {', '.join(sorted(names))}: {words}" for words, names in runs.items() if words]

    def _tallies(self) -> tuple[ClaimTally, ...]:
        from safety_harness.testing.plugin.payloads import judgements, tallies_of

        return tallies_of(j for sent in self._sent for j in judgements(sent))

    def _basis(self) -> str:
        """What the verdicts of the session rest on."""
        from safety_harness.claims.properties.tally import basis_of_tallies
        from safety_harness.testing.plugin.payloads import judgements

        worlds = (j.run.world for sent in self._sent for j in judgements(sent))
        return basis_of_tallies(worlds, self._tallies())

    def _untested(self) -> list[str]:
        return [tally.sentence for tally in self._tallies() if tally.untested] if self._sent else []
