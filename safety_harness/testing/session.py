"""Define the options that the tests of a session share, and the test that is running now.

This module imports nothing heavy, because the pytest plug-in loads it in every project.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from safety_harness.base.exceptions import SafetyHarnessError
    from safety_harness.claims.properties.against import RunDifference
    from safety_harness.claims.properties.base import Evaluation
    from safety_harness.claims.properties.tried import TriedParts
    from safety_harness.report.decisions import ComputingTime
    from safety_harness.scenario.model import Verdict
    from safety_harness.trace.overruling import Overruling
    from safety_harness.trace.trace import Trace


FAILURES = Path(".safety-harness") / "failures"


@dataclass(frozen=True)
class Profile:
    """The effort of a test.

    ``examples`` is the number of scenarios that each test draws, and ``shrinking_runs`` is the number of
    simulations after a failure.
    """

    name: str
    examples: int
    shrinking_runs: int


QUICK = Profile("quick", 50, 60)  # for daily work, and for every push
PROFILES = (QUICK, Profile("nightly", 500, 400), Profile("certify", 3000, 2000))


@dataclass(frozen=True)
class Run:
    """The facts about a run that remain after its trace is deleted.

    ``sound`` is True if the run was complete and all its values are finite.
    """

    name: str  # of its scenario
    tested: str  # "avoider" or "controller", and its name
    seed: int
    sound: bool
    world: str  # in words
    beside: str = ""  # ``tested`` with its shield and with settings that differ from the defaults


@dataclass(frozen=True, eq=False)
class Judgement:
    """A claim that a test judged in a run.

    ``expected`` is the verdict that the test or the file expects.
    """

    run: Run
    evaluation: Evaluation
    expected: Verdict

    @property
    def severity(self) -> tuple[bool, float]:
        """Return a sort key that puts unexpected verdicts first, and then the least margins."""
        evaluation, margin = self.evaluation, self.evaluation.margin
        broken = evaluation.verdict is not self.expected and evaluation.verdict.value != "inconclusive"
        return not broken, inf if margin is None else margin


@dataclass(eq=False)
class TestRun:
    """A running test, its judgements so far, and its failure if it has failed.

    ``draws`` states that Hypothesis chooses the scenarios. In this case an inconclusive run is no failure,
    unless all runs are inconclusive. After the first ``failure``, Hypothesis only simplifies the failing
    example. The runs of this phase are not evidence.
    """

    __test__ = False  # its name is not meant for pytest

    id: str
    draws: bool
    keep_traces: bool = False
    judgements: list[Judgement] = field(default_factory=list)
    worst: dict[str, Judgement] = field(default_factory=dict)  # the worst judgement of each sentence
    traces: dict[str, Trace] = field(default_factory=dict)  # the traces of these judgements, by sentence
    fallback: Trace | None = None  # the trace of the first run in which the avoider did not answer
    failure: BaseException | None = None
    simulated: set[str] = field(default_factory=set)  # digests of the present example's scenarios
    failing: set[str] = field(default_factory=set)  # digests of the scenarios of failed examples
    refused: dict[str, SafetyHarnessError] = field(default_factory=dict)  # by digest
    examples: int = 0  # examples that were begun
    asked: bool = False  # whether the test called ``simulate``, even if that was refused
    runs_since: int = 0  # simulations since the first failure
    kept: Path | None = None  # where the failing scenario was written
    replayed: list[Path] = field(default_factory=list)  # earlier failures that were tried first
    as_kept: bool = False  # whether they ran with the avoiders of their files
    computing_times: list[ComputingTime] = field(default_factory=list)  # one for each of its runs
    overruled: dict[str, Overruling] = field(default_factory=dict)  # of the runs that count, by digest
    tried: dict[str, TriedParts] = field(default_factory=dict)  # of the runs that count, by digest
    differences: dict[str, RunDifference] = field(default_factory=dict)  # from a reference, by digest
    shared: list[str] = field(default_factory=list)  # failures that the reference has as well
    judges_itself: bool = False  # a marker states that the test judges runs without assert_holds
    of_another: list[str] = field(default_factory=list)  # violations that the file expects of its own avoider
    not_taken: str = ""  # the avoider that cannot take its scenario

    @property
    def counts(self) -> bool:
        """Return whether the current run counts as evidence.

        A run is not evidence if Hypothesis only simplifies a failing example.
        """
        return self.failure is None or not self.draws

    def fail(self, failure: BaseException) -> None:
        """Record that the present example failed."""
        self.failure = failure
        self.failing |= self.simulated

    def note(self, judgement: Judgement, trace: Trace | None) -> None:
        """Record a judgement.

        If it is the worst judgement of its sentence so far, it is also kept for the summary.
        """
        self.judgements.append(judgement)
        earlier = self.worst.get(judgement.evaluation.sentence)
        if earlier is None or judgement.severity < earlier.severity:
            self.show(judgement, trace)

    def show(self, judgement: Judgement, trace: Trace | None) -> None:
        """Record ``judgement`` as the judgement that summaries and the report use for its sentence."""
        sentence = judgement.evaluation.sentence
        self.worst[sentence] = judgement
        if self.keep_traces and trace is not None:
            self.traces[sentence] = trace


@dataclass(eq=False)
class Session:
    """A session of tests.

    The default values are suitable for a script or a notebook that does not use pytest.
    """

    root: Path = field(default_factory=Path.cwd)
    profile: Profile = QUICK
    derandomize: bool = False
    seed: int = 0
    avoider: str | None = None
    against: str | None = None
    world: str = ""  # empty: PyBullet, or the kinematic world if PyBullet is missing
    failures: Path = FAILURES
    report: Path | None = None
    saved: set[Path] = field(default_factory=set)  # traces that this process wrote for the report
    recordings: dict[str, bytes] = field(default_factory=dict)  # of logs, by their SHA-256
    simulated: set[str] = field(default_factory=set)  # keys of the runs since the last test report
    judged: set[str] = field(default_factory=set)  # keys of runs judged since then, even if simulated earlier
    ignored: list[str] = field(default_factory=list)  # other programs' files with a title like ours
    test: TestRun | None = None


_current = Session()


def session() -> Session:
    """Return the session of this process."""
    return _current


def begin(new: Session) -> Session:
    """Make ``new`` the session of this process, and return the earlier session."""
    global _current
    previous, _current = _current, new
    return previous
