"""Check repeatability: a second avoider answers the first avoider's questions again, in another order.

The questions come from stored runs, so the check disturbs no run. If the avoider is a file that must be
executed, the second avoider runs in a separate process. Any other avoider is a pure function, and the second
avoider runs in this process. The hash of a question decides whether the question is repeated, and determines
its position in the repetition. Therefore the sample and its order do not depend on the order in which runs
end, or on a shared seed.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from heapq import nsmallest
from operator import attrgetter
from typing import ClassVar

import numpy as np

from safety_harness.admission.admit import Admitter, first_question
from safety_harness.admission.avoiders import Avoiders, is_a_program
from safety_harness.admission.trial import run_trial
from safety_harness.base.elementary import length
from safety_harness.base.exceptions import InputError, NoAnswerError, SimulationError, printable
from safety_harness.base.output import Output
from safety_harness.cell.avoidance.asking import (
    Answer,
    OutOfProcessAvoider,
    Question,
    answers_together,
    ask,
    takes_many,
)
from safety_harness.cell.avoidance.avoider import Avoider, shown_to
from safety_harness.cell.avoidance.flaky import Asked, asked_in, difference
from safety_harness.cell.avoidance.isolation.apart import processes_apart
from safety_harness.cell.simulation.worlds import SIMULATOR, is_simulator, world_of_trace
from safety_harness.scenario.model import Driver, Scenario
from safety_harness.trace.trace import Trace

SHARE = 0.02  # the share of a command's time, without the start of the process
LEAST, MOST = 8, 1_000  # the least and largest number of repeated questions
LEAST_RUNS, MOST_RUNS = 3, 20  # of a controller's runs that are repeated
ROUNDING_M = 1e-9  # closer answers are equal, since batches of other sizes may round differently
ROUNDED = "the avoider rounds otherwise when it is asked otherwise"
Difference = tuple[float, str]  # distance of the two answers [m], inf without an answer; in words


@dataclass(frozen=True, kw_only=True)
class RepeatabilityResult:
    """The result of repeating the questions of an avoider.

    Args:
        questions: The number of questions in the runs.
        asked: The number of questions that were repeated.
        differing: The number of repeated questions with a different answer.
        words: A text that describes the largest difference. If no answer differs by more than ``ROUNDING_M``,
            it states the size of the rounding, or the reason why no more questions could be asked.
        apart: Whether the second avoider ran in another process.
        together: Whether the questions were also repeated in a single call.

    """

    questions: int
    asked: int = 0
    differing: int = 0
    words: str = ""
    apart: bool = False
    together: bool = False
    _repeated: ClassVar[str] = "answers"

    @property
    def problem(self) -> str:
        """The reason for which the command ends with exit code 1.

        The text is empty if answers differ only by rounding.
        """
        return "" if self.words.startswith(ROUNDED) else self.words

    @property
    def remembers(self) -> str:
        """A text on different answers to equal questions, or an empty text if no answer differs."""
        differ = f"{self.differing} of {self.asked} {self._repeated} differ"
        return f"{self.words}; {differ}" if self.differing else ""

    @property
    def line(self) -> str:
        """The result as a single line of text."""
        return self.remembers or self.words or f"repeatability: {self._alike}"

    @property
    def _alike(self) -> str:
        """The single line for the case that all answers are equal."""
        if not self.asked:
            return "the avoider was asked nothing that could be asked again"
        where = "a second avoider in a process of its own" if self.apart else "a second avoider"
        manner = "alone, in another order and together" if self.together else "alone and in another order"
        repeated = f"{self.asked} of {self.questions} questions asked again of {where}"
        return f"{repeated}, {manner}: the same answers"


@dataclass(frozen=True, kw_only=True)
class DrivenAgain(RepeatabilityResult):
    """The result of repeating runs.

    New controllers repeated ``asked`` runs out of the ``questions`` runs in total. If ``of_avoider`` is true,
    the visual servo drove these runs, and a new avoider was used for each repetition. ``beside`` lists the
    kinds of other parts that were created anew: safety filter, predictor. If ``of_simulator`` is true, the
    runs took place in a user's simulator.
    """

    of_avoider: bool = False
    beside: tuple[str, ...] = ()
    of_simulator: bool = False
    _repeated: ClassVar[str] = "runs"

    @property
    def who(self) -> str:
        """The parts that may have caused a difference between two repetitions of a run."""
        return "simulator or the system in it" if self.of_simulator else " or its ".join(self._parts)

    @property
    def _parts(self) -> tuple[str, ...]:
        return ("avoider" if self.of_avoider else "controller", *self.beside)

    @property
    def _alike(self) -> str:
        """The single line for the case that all repeated runs are equal."""
        if not self.asked:
            return f"the {self.who} ended no run that could be driven again"
        runs, fresh = f"{self.asked} of {self.questions} runs", " and ".join(self._parts)
        if self.of_simulator:
            return f"{runs} made again in the simulator, with a fresh system: the same to the last bit"
        again = f"{runs} driven again by a fresh {fresh}"
        return f"{again}: the same to the last bit"


@dataclass(frozen=True)
class DrivenRun:
    """A run that may be repeated, with hashes that show whether the repetition is the same.

    ``sha256`` is the hash of the run's commands and joint angles. ``controller_sha256`` is the hash of the
    file of the controller or the avoider. If ``asks`` is true, the visual servo drove the run and queried the
    avoider in that file. ``parts`` lists the references to the parts of the system, beginning with the
    controller or avoider. ``beside`` lists the kinds of the remaining parts. ``simulated`` is true if the
    world is a user's simulator.
    """

    run: str
    world: str
    sha256: str
    controller_sha256: str
    asks: bool = False
    parts: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    simulated: bool = False

    @property
    def driven(self) -> bool:
        """Whether a controller other than the visual servo drove the run."""
        return not self.parts or isinstance(self.parts[0], Driver)


def driven_in(trace: Trace) -> DrivenRun | None:
    """Return the data of a run that can be repeated as a whole, or None if it cannot.

    The result is None if the run broke off, or if only its questions need to be repeated.
    """
    scenario, simulated = trace.scenario, is_simulator(trace.provenance.world)
    programs = scenario.driven or is_a_program(scenario.avoider) or scenario.has_parts_beside
    if not (programs or simulated) or not trace.complete:
        return None
    commands = trace.ticks["demanded_joint_velocity_radps"].tobytes()
    commands += trace.decisions["proposed_position_in_base_m"].tobytes()
    commands += trace.predicted["shape_m2"].tobytes() + trace.predicted["box"].tobytes()
    digest = hashlib.sha256(commands + trace.ticks["joint_position_rad"].tobytes()).hexdigest()
    beside = (trace.system.safety_filter, trace.system.predictor)
    sha256 = trace.system.tested.sha256 + "".join(part.sha256 for part in beside if part is not None)
    sha256 += dict(trace.provenance.libraries).get(SIMULATOR, "") if simulated else ""
    kinds = {"safety filter": scenario.safety_filter, "predictor": scenario.predictor}
    return DrivenRun(
        scenario.name,
        trace.provenance.world,
        digest,
        sha256,
        not (scenario.driven or scenario.has_parts_beside or simulated),
        scenario.parts_under_test,
        tuple(kind for kind, reference in kinds.items() if reference),
        simulated,
    )


@dataclass(frozen=True, eq=False)
class _Sampled:
    """A question of a run, with the data that are needed to repeat it.

    ``order`` is the hash that decides whether the question is drawn.
    """

    order: bytes
    case: Asked
    scenario: Callable[[], Scenario]
    avoider_sha256: str


class Repeatability:
    """A collection of the questions that avoiders have answered.

    The method ``check`` repeats a sample of them.  If a controller other than the visual servo drives the
    arm, the object collects whole runs, and a new controller repeats a sample of them.  The repetition
    reveals a controller that stores data from earlier episodes, because it then drives differently.

    The time available limits the size of the sample.  ``check`` may use the fraction ``SHARE`` of the time
    since the object was created, but repeats at least ``LEAST`` questions.
    """

    def __init__(self) -> None:
        self._begun_s = time.monotonic()
        self._questions = 0
        self._sample: list[_Sampled] = []
        self._runs = 0
        self._driven: list[tuple[DrivenRun, Callable[[], Scenario]]] = []
        self._last: Callable[[], Scenario] | None = None  # of the last run, even if it broke off

    def add(self, trace: Trace) -> None:
        """Add the questions of a run, or the whole run if it has a user's controller, program or simulator.

        A run cannot be repeated if its controller was passed as a Python object.
        """
        scenario = trace.scenario
        driven = driven_in(trace)
        if driven is not None:
            self.take_run(driven, lambda: scenario)
        cases = () if scenario.driven else asked_in(trace)
        self.take(cases, lambda: scenario, trace.system.tested.sha256)

    def take(
        self, cases: Iterable[Asked], scenario: Callable[[], Scenario], avoider_sha256: str = ""
    ) -> None:
        """Add the questions ``cases`` of a run.

        ``scenario`` is a function that returns the run's scenario, which refers to the avoider.
        """
        self._last = scenario
        for case in cases:
            self._questions += 1
            self._sample.append(_Sampled(_order(case.question), case, scenario, avoider_sha256))
        # Cut the sample only when it has doubled, so that most additions cost no search.
        if len(self._sample) > 2 * MOST:
            self._sample = self._drawn()

    def take_run(self, run: DrivenRun, scenario: Callable[[], Scenario]) -> None:
        """Add a whole run.

        ``scenario`` is a function that returns the run's scenario, which refers to the controller.
        """
        self._runs += 1
        self._driven.append((run, scenario))
        if len(self._driven) > 2 * MOST_RUNS:
            self._driven = self._drawn_runs()

    def _drawn_runs(self) -> list[tuple[DrivenRun, Callable[[], Scenario]]]:
        """Return the sample of runs.

        It begins with one run of each different system.
        """
        ordered = sorted(self._driven, key=lambda item: item[0].sha256)
        # Reversed, so that the first run of each system in the order of the hashes remains.
        firsts = {run.parts: run for run, _ in reversed(ordered)}
        first = [item for item in ordered if item[0] == firsts[item[0].parts]]
        return [*first, *(item for item in ordered if item not in first)][: max(MOST_RUNS, len(first))]

    def _drive_again(self, allowed_s: float) -> RepeatabilityResult:
        """Repeat a sample of the runs for ``allowed_s`` seconds, but at least LEAST_RUNS runs."""
        begun_s, again, texts = time.monotonic(), 0, list[str]()
        of_avoider = bool(self._driven) and not any(run.driven for run, _ in self._driven)
        result = DrivenAgain(
            questions=self._runs,
            of_avoider=of_avoider,
            beside=tuple(dict.fromkeys(kind for run, _ in self._driven for kind in run.beside)),
            of_simulator=any(run.simulated for run, _ in self._driven),
        )
        least = max(LEAST_RUNS, len({run.parts for run, _ in self._driven}))
        for run, scenario in self._drawn_runs():
            if again >= least and time.monotonic() - begun_s > allowed_s:
                break
            try:
                who = replace(result, beside=run.beside).who
                otherwise = _driven_otherwise(run, scenario(), who)
            except (InputError, SimulationError) as error:
                problem = f"the {result.who} could not drive again: {printable(str(error))}"
                return replace(result, asked=again, words=problem)
            again += 1
            texts += [otherwise] if otherwise else []
        return replace(result, asked=again, differing=len(texts), words=texts[0] if texts else "")

    def check(self, least: int = LEAST) -> RepeatabilityResult:
        """Repeat the questions one by one, in the order of their hashes, and then all of them in one call."""
        allowed_s = SHARE * (time.monotonic() - self._begun_s)
        if not all(run.asks for run, _ in self._driven) or self._only_controllers_broke_off():
            return self._drive_again(allowed_s)
        again = _Again()
        with processes_apart():
            try:
                again.ask(self._drawn(), least, allowed_s)
            except (InputError, SimulationError) as error:
                again.problem = f"the avoider could not be asked again: {printable(str(error))}"
            if again.unkept:
                return self._drive_again(allowed_s)
        diffs = again.differing.values()
        differing = [answer for answer in diffs if answer[0] > ROUNDING_M]
        rounded = f"{ROUNDED}, {len(diffs)} of {again.asked} answers: {max(diffs)[1]}" if diffs else ""
        return RepeatabilityResult(
            questions=self._questions,
            asked=again.asked,
            differing=len(differing),
            words=max(differing, default=(0.0, again.problem or rounded))[1],
            apart=any(isinstance(second.avoider, OutOfProcessAvoider) for second in again.seconds.values()),
            together=any(second.answers_many for second in again.seconds.values()),
        )

    def reported(self, output: Output) -> RepeatabilityResult | None:
        """Print the result of ``check`` and return it.

        Return None if the user pressed Ctrl-C.
        """
        try:
            result = self.check()
        except KeyboardInterrupt:
            return None
        show = output.say if result.words else output.detail
        show(f"{'error: ' if result.problem else ''}{result.line}")
        return result

    def _only_controllers_broke_off(self) -> bool:
        """Return whether all runs broke off and had a controller that queries no avoider."""
        if self._questions or self._driven or self._last is None:
            return False
        try:
            return self._last().driven
        except (InputError, SimulationError):
            return False

    def _drawn(self) -> list[_Sampled]:
        """Return the sample of questions, in the order of the hashes."""
        return nsmallest(MOST, self._sample, key=attrgetter("order"))


def _driven_otherwise(run: DrivenRun, scenario: Scenario, who: str) -> str:
    """Return a text that describes why repetitions with new controllers differ, or an empty text."""
    world = world_of_trace(run.world)
    runs = [driven_in(run_trial(Admitter().admit(scenario), world=world)) for _ in range(2)]
    again = [run_again for run_again in runs if run_again is not None]
    if len(again) < 2:
        return f"{run.run} broke off when it was driven again"
    if again[0].controller_sha256 != run.controller_sha256:
        return f"the file of the {who} has changed since {run.run} was driven"
    if again[0].sha256 != again[1].sha256:
        twice, fresh = f"{run.run} differs in two turns", f"two fresh ones drive {run.run} differently"
        return f"the {who} does not repeat itself: {twice if run.simulated else fresh}"
    if again[0].sha256 != run.sha256 and run.simulated:
        return f"the {who} carries something over from earlier episodes: {run.run}, run again, differs"
    if again[0].sha256 != run.sha256:
        carries = f"the {who} carries something over from earlier episodes"
        carries += ", or its act_many is not its act" if run.driven and not run.beside else ""
        return f"{carries}: a fresh one, alone, drives {run.run} otherwise"
    return ""


def _order(question: Question) -> bytes:
    """Return the hash of a question, which decides whether and when the question is repeated."""
    text = question.hand_position_in_base_m.tobytes() + question.tcp_position_in_base_m.tobytes()
    return hashlib.sha256(text + question.seed.to_bytes(8, "little")).digest()


@dataclass(eq=False)
class _Again:
    """The result of repeating questions.

    ``seconds`` contains the second avoiders, with the identity of the first avoider as the key. ``differing``
    contains the differing answers, with the question as the key.
    """

    asked: int = 0
    problem: str = ""
    unkept: bool = False  # the avoider sees more than a trace keeps
    differing: dict[Asked, Difference] = field(default_factory=dict)
    seconds: dict[int, _Second] = field(default_factory=dict)

    def ask(self, sample: list[_Sampled], least: int, allowed_s: float) -> None:
        """Ask the questions of ``sample`` one by one, and then all together in one call.

        The first phase stops after half of ``allowed_s``, but not before ``least`` questions.  The single
        call is expected to take no longer than the first phase.
        """
        avoiders, begun_s = Avoiders(), 0.0
        for sampled in sample:
            if self.asked >= least and time.monotonic() - begun_s > allowed_s / 2.0:
                break
            scenario = sampled.scenario()
            avoider, sha256 = avoiders.avoider_for(scenario)
            if sha256 != (sampled.avoider_sha256 or sha256):
                self.problem = "the avoider's file has changed since it was asked: it was not asked again"
                return
            if shown_to(avoider):
                self.unkept = True
                return
            begun_s = begun_s or time.monotonic()  # the clock starts when its process has started
            hand, tcp = first_question(scenario.settings)
            new = _Second(avoider, Question(np.array(hand), np.array(tcp), 0))
            second = self.seconds.setdefault(id(avoider), new)
            self.asked += 1
            answer_differs = second.alone(sampled.case)
            if answer_differs:
                self.differing[sampled.case] = answer_differs
            if second.hangs:
                return
        for second in self.seconds.values():
            for question, answer_differs in second.together():
                self.differing.setdefault(question, answer_differs)


@dataclass(eq=False)
class _Second:
    """A second avoider, with the questions to repeat.

    ``first`` is a question that no run has used.
    """

    avoider: Avoider
    first: Question
    asked: list[Asked] = field(default_factory=list)
    hangs: bool = False
    answers_many: bool = False

    @property
    def _takes_many(self) -> bool:
        """Whether the avoider can answer many questions in one call."""
        avoider = self.avoider
        return avoider.takes_many if isinstance(avoider, OutOfProcessAvoider) else takes_many(avoider)

    def alone(self, case: Asked) -> Difference | None:
        """Return how the avoider's answer to one question differs from the first answer, or None."""
        self.asked.append(case)
        why = "the avoider remembers" + (", or heeds what else is asked" if self._takes_many else "")
        try:
            return _compared(f"{why}: asked again alone", case, ask(self.avoider, case.question))
        except NoAnswerError as error:
            self.hangs = True
            return np.inf, f"{why}: asked again alone it hangs: {error} ({_place(case)})"

    def together(self) -> Iterator[tuple[Asked, Difference]]:
        """Ask all questions in one call.

        Yield each question whose answer differs from its first answer, with a text on the difference.
        """
        if self._takes_many:
            answers = answers_together(self.avoider, [self.first, *(case.question for case in self.asked)])
            if not answers or not np.isnan(answers[0].latency_s):  # it answered them one by one
                return
            self.answers_many = True
            why = "the avoider heeds what else is asked: asked again in one call with others"
            for case, answer in zip(self.asked, answers[1:], strict=False):
                if answer_differs := _compared(why, case, answer):
                    yield case, answer_differs


def _compared(why: str, case: Asked, answer: Answer) -> Difference | None:
    """Return the difference between ``answer`` and the first answer to ``case``.

    Return None if the answers are equal.
    """
    how = difference(case.answer, answer)
    if not how:
        return None
    a, b = case.answer.proposal, answer.proposal
    off_m = length([a.position_in_base_m - b.position_in_base_m, a.spread_m - b.spread_m])
    same = np.array_equal(case.answer.spread_threshold_m, answer.spread_threshold_m, equal_nan=True)
    return off_m if same and np.isfinite(off_m) else np.inf, f"{why} {how} ({_place(case)})"


def _place(case: Asked) -> str:
    """Return a text with the number of a question and the name of its run."""
    return f"question {case.number} of {case.run}"
