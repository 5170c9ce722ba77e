"""Does an avoider answer alike when a second one is asked what the first was, alone and in another order?

The questions are taken from what runs left behind, so that no run is touched.  Of a file that is executed
the second avoider is made in a process of its own; any other is a function by construction, and is asked
here.  What is asked, and in which order, is drawn by a hash of the question itself: it hangs neither on which
run ends first nor on a seed that something else uses.
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
from safety_harness.cell.avoidance.isolation.isolated import processes_apart
from safety_harness.cell.simulation.worlds import world_of_trace
from safety_harness.scenario.model import Scenario
from safety_harness.trace.trace import Trace

SHARE = 0.02  # of the time that a command took, beside the start of the process
LEAST, MOST = 8, 1_000  # questions that are asked again, if there are as many
LEAST_RUNS, MOST_RUNS = 3, 20  # of a controller, that are driven again
ROUNDING_M = 1e-9  # answers this near are alike: the order of a sum may depend on the size of a batch
ROUNDED = "the avoider rounds otherwise when it is asked otherwise"
Difference = tuple[float, str]  # how far elsewhere the answer was [m], inf where it was none; in words


@dataclass(frozen=True, kw_only=True)
class RepeatabilityResult:
    """Of ``questions`` of the runs ``asked`` were asked again, ``differing`` of them answered otherwise.

    ``words`` says how, of the worst; if none differs by more than ``ROUNDING_M``, why no more could be
    asked, or how it rounds.  ``apart``: was any of them asked in another process?  ``together``: were they
    answered in one call as well?
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
        """Say why a command ends with 1; rounding is only reported."""
        return "" if self.words.startswith(ROUNDED) else self.words

    @property
    def remembers(self) -> str:
        """That it is no function of its question, or does not repeat itself; empty if that was not seen."""
        differ = f"{self.differing} of {self.asked} {self._repeated} differ"
        return f"{self.words}; {differ}" if self.differing else ""

    @property
    def line(self) -> str:
        """What came out."""
        return self.remembers or self.words or f"repeatability: {self._alike}"

    @property
    def _alike(self) -> str:
        if not self.asked:
            return "the avoider was asked nothing that could be asked again"
        where = "a second avoider in a process of its own" if self.apart else "a second avoider"
        ways = "alone, in another order and together" if self.together else "alone and in another order"
        asked = f"{self.asked} of {self.questions} questions asked again of {where}"
        return f"{asked}, {ways}: the same answers"


@dataclass(frozen=True, kw_only=True)
class DrivenAgain(RepeatabilityResult):
    """Of so many runs (``questions``) those ``asked`` were driven again by a fresh controller.

    ``of_avoider``: by the visual servo with a fresh avoider, of what the avoider sees no trace keeps all.
    """

    of_avoider: bool = False
    _repeated: ClassVar[str] = "runs"

    @property
    def who(self) -> str:
        """Who drove them."""
        return "avoider" if self.of_avoider else "controller"

    @property
    def _alike(self) -> str:
        if not self.asked:
            return f"the {self.who} ended no run that could be driven again"
        again = f"{self.asked} of {self.questions} runs driven again by a fresh {self.who}"
        return f"{again}: the same to the last bit"


@dataclass(frozen=True)
class DrivenRun:
    """A run that may be driven again: scenario, world, a hash of what the arm was told, and the file's.

    ``asks``: by the visual servo, which asks the avoider of the file.
    """

    run: str
    world: str
    sha256: str
    controller_sha256: str
    asks: bool = False


def driven_in(trace: Trace) -> DrivenRun | None:
    """What of a run has to come out again; None where questions of it can be asked again, or it broke off."""
    scenario = trace.scenario
    if not (scenario.driven or is_a_program(scenario.avoider)) or not trace.complete:
        return None
    told = trace.ticks["demanded_joint_velocity_radps"].tobytes()
    told += trace.decisions["proposed_position_in_base_m"].tobytes()
    digest = hashlib.sha256(told + trace.ticks["joint_position_rad"].tobytes()).hexdigest()
    sha256 = trace.system.tested.sha256
    return DrivenRun(scenario.name, trace.provenance.world, digest, sha256, not scenario.driven)


@dataclass(frozen=True, eq=False)
class _Sampled:
    """A question, the hash that draws it, and the scenario and the file of its avoider."""

    order: bytes
    one: Asked
    scenario: Callable[[], Scenario]
    avoider_sha256: str


class Repeatability:
    """Takes in what avoiders were asked from now on; ``check`` asks a sample of it again.

    Of another controller than the visual servo it takes in the runs, and has a sample driven again by fresh
    ones: what a controller carries over from earlier episodes comes out otherwise.

    How many are asked hangs on the wall's clock: as many as take ``SHARE`` of the time since this was made,
    and ``LEAST`` at least.
    """

    def __init__(self) -> None:
        self._begun_s = time.monotonic()
        self._questions = 0
        self._sample: list[_Sampled] = []
        self._runs = 0
        self._driven: list[tuple[DrivenRun, Callable[[], Scenario]]] = []
        self._last: Callable[[], Scenario] | None = None  # of a run, whatever came of it

    def add(self, trace: Trace) -> None:
        """The questions of a run, or the run of a controller that is named: an object cannot be made anew."""
        scenario = trace.scenario
        driven = driven_in(trace)
        if driven is not None:
            self.take_run(driven, lambda: scenario)
        asked = () if scenario.driven else asked_in(trace)
        self.take(asked, lambda: scenario, trace.system.tested.sha256)

    def take(
        self, asked: Iterable[Asked], scenario: Callable[[], Scenario], avoider_sha256: str = ""
    ) -> None:
        """Questions of a run; ``scenario`` gives the one that names its avoider, when it is needed."""
        self._last = scenario
        for one in asked:
            self._questions += 1
            self._sample.append(_Sampled(_order(one.question), one, scenario, avoider_sha256))
        if len(self._sample) > 2 * MOST:
            self._sample = self._drawn()

    def take_run(self, run: DrivenRun, scenario: Callable[[], Scenario]) -> None:
        """A whole run; ``scenario`` gives the one that names its controller, when it is needed."""
        self._runs += 1
        self._driven.append((run, scenario))
        if len(self._driven) > 2 * MOST_RUNS:
            self._driven = self._drawn_runs()

    def _drawn_runs(self) -> list[tuple[DrivenRun, Callable[[], Scenario]]]:
        return nsmallest(MOST_RUNS, self._driven, key=lambda one: one[0].sha256)

    def _drive_again(self, allowed_s: float) -> RepeatabilityResult:
        begun_s, asked, words = time.monotonic(), 0, list[str]()
        of_avoider = bool(self._driven) and all(run.asks for run, _ in self._driven)
        found = DrivenAgain(questions=self._runs, of_avoider=of_avoider)
        for run, scenario in self._drawn_runs():
            if asked >= LEAST_RUNS and time.monotonic() - begun_s > allowed_s:
                break
            try:
                otherwise = _driven_otherwise(run, scenario(), found.who)
            except (InputError, SimulationError) as error:
                problem = f"the {found.who} could not drive again: {printable(str(error))}"
                return replace(found, asked=asked, words=problem)
            asked += 1
            words += [otherwise] if otherwise else []
        return replace(found, asked=asked, differing=len(words), words=words[0] if words else "")

    def check(self, least: int = LEAST) -> RepeatabilityResult:
        """Ask again, each question alone and in the order of the hashes, then all in one call."""
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
        found = again.differing.values()
        differing = [one for one in found if one[0] > ROUNDING_M]
        rounded = f"{ROUNDED}, {len(found)} of {again.asked} answers: {max(found)[1]}" if found else ""
        return RepeatabilityResult(
            questions=self._questions,
            asked=again.asked,
            differing=len(differing),
            words=max(differing, default=(0.0, again.problem or rounded))[1],
            apart=any(isinstance(second.avoider, OutOfProcessAvoider) for second in again.seconds.values()),
            together=any(second.answers_many for second in again.seconds.values()),
        )

    def reported(self, output: Output) -> RepeatabilityResult | None:
        """``check``, and say what came out; None where Ctrl-C came."""
        try:
            found = self.check()
        except KeyboardInterrupt:
            return None
        (output.say if found.words else output.detail)(f"{'error: ' * bool(found.problem)}{found.line}")
        return found

    def _only_controllers_broke_off(self) -> bool:
        """Is there nothing to ask or to drive, of runs that ask no avoider?"""
        if self._questions or self._driven or self._last is None:
            return False
        try:
            return self._last().driven
        except (InputError, SimulationError):
            return False

    def _drawn(self) -> list[_Sampled]:
        return nsmallest(MOST, self._sample, key=attrgetter("order"))


def _driven_otherwise(run: DrivenRun, scenario: Scenario, who: str) -> str:
    """Why a fresh one drives the same scenario otherwise, in words; empty if it does not."""
    world = world_of_trace(run.world)
    runs = [driven_in(run_trial(Admitter().admit(scenario), world=world)) for _ in range(2)]
    again = [one for one in runs if one is not None]
    if len(again) < 2:
        return f"{run.run} broke off when it was driven again"
    if again[0].controller_sha256 != run.controller_sha256:
        return f"the {who}'s file has changed since {run.run} was driven"
    if again[0].sha256 != again[1].sha256:
        return f"the {who} does not repeat itself: two fresh ones drive {run.run} differently"
    if again[0].sha256 != run.sha256:
        carries = f"the {who} carries something over from earlier episodes"
        carries += "" if run.asks else ", or its act_many is not its act"
        return f"{carries}: a fresh one, alone, drives {run.run} otherwise"
    return ""


def _order(question: Question) -> bytes:
    text = question.hand_position_in_base_m.tobytes() + question.tcp_position_in_base_m.tobytes()
    return hashlib.sha256(text + question.seed.to_bytes(8, "little")).digest()


@dataclass(eq=False)
class _Again:
    """What comes of asking again: ``seconds`` are avoiders by identity, ``differing`` is by question."""

    asked: int = 0
    problem: str = ""
    unkept: bool = False  # the avoider sees more than a trace keeps
    differing: dict[Asked, Difference] = field(default_factory=dict)
    seconds: dict[int, _Second] = field(default_factory=dict)

    def ask(self, sample: list[_Sampled], least: int, allowed_s: float) -> None:
        """All of the sample, or as many as half of the time allows; together they take no longer."""
        avoiders, begun_s = Avoiders(), 0.0
        for sampled in sample:
            if self.asked >= least and time.monotonic() - begun_s > allowed_s / 2.0:
                break
            scenario = sampled.scenario()
            avoider, sha256 = avoiders.of(scenario)
            if sha256 != (sampled.avoider_sha256 or sha256):
                self.problem = "the avoider's file has changed since it was asked: it was not asked again"
                return
            if shown_to(avoider):
                self.unkept = True
                return
            begun_s = begun_s or time.monotonic()  # its process is there
            hand, tcp = first_question(scenario.settings)
            new = _Second(avoider, Question(np.array(hand), np.array(tcp), 0))
            second = self.seconds.setdefault(id(avoider), new)
            self.asked += 1
            found = second.alone(sampled.one)
            if found:
                self.differing[sampled.one] = found
            if second.hangs:
                return
        for second in self.seconds.values():
            for one, found in second.together():
                self.differing.setdefault(one, found)


@dataclass(eq=False)
class _Second:
    """A second avoider, and what it was asked; ``first`` is a question that no run has."""

    avoider: Avoider
    first: Question
    asked: list[Asked] = field(default_factory=list)
    hangs: bool = False
    answers_many: bool = False

    @property
    def _takes_many(self) -> bool:
        avoider = self.avoider
        return avoider.takes_many if isinstance(avoider, OutOfProcessAvoider) else takes_many(avoider)

    def alone(self, one: Asked) -> Difference | None:
        """How its answer differs, if it does."""
        self.asked.append(one)
        why = "the avoider remembers" + (", or heeds what else is asked" if self._takes_many else "")
        try:
            return _told(f"{why}: asked again alone", one, ask(self.avoider, one.question))
        except NoAnswerError as error:
            self.hangs = True
            return np.inf, f"{why}: asked again alone it hangs: {error} ({_place(one)})"

    def together(self) -> Iterator[tuple[Asked, Difference]]:
        """The questions whose answers differ when all are asked in one call, and how."""
        if self._takes_many:
            answers = answers_together(self.avoider, [self.first, *(one.question for one in self.asked)])
            if not answers or not np.isnan(answers[0].latency_s):  # it cannot, and was asked in turn
                return
            self.answers_many = True
            why = "the avoider heeds what else is asked: asked again in one call with others"
            for one, answer in zip(self.asked, answers[1:], strict=False):
                if found := _told(why, one, answer):
                    yield one, found


def _told(why: str, one: Asked, answer: Answer) -> Difference | None:
    how = difference(one.answer, answer)
    if not how:
        return None
    a, b = one.answer.proposal, answer.proposal
    off_m = float(np.linalg.norm([a.position_in_base_m - b.position_in_base_m, a.spread_m - b.spread_m]))
    same = np.array_equal(one.answer.spread_threshold_m, answer.spread_threshold_m, equal_nan=True)
    return off_m if same and np.isfinite(off_m) else np.inf, f"{why} {how} ({_place(one)})"


def _place(one: Asked) -> str:
    return f"question {one.number} of {one.run}"
