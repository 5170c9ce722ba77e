"""Measure the answer times of an avoider or a controller on this machine, as a profile for scenarios."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import FIRST_ANSWER_S, Admitter, answers_at_first, first_question
from safety_harness.admission.avoiders import (
    avoider_sha256,
    resolve_avoider,
    scenario_of_avoider,
    with_avoider,
)
from safety_harness.admission.driving import named_system
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import InadmissibleError, NoAnswerError, Place
from safety_harness.base.seeds import Branch, generator
from safety_harness.base.settings import DEFAULTS, DecisionCost, DecisionTimes, Measured
from safety_harness.cell.avoidance.asking import Question, ask
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.simulation.simulate import INTERRUPTED
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.scenario.fields import is_sentence
from safety_harness.scenario.model import Driver, Scenario
from safety_harness.scenario.references import file_and_name
from safety_harness.seams.contract import acts_per_answer_of

QUANTILES = 101  # from the quickest answer to the slowest
AROUND_M = 0.15  # half the box about the nominal hand and the desired TCP, on each axis


@dataclass(frozen=True, eq=False)
class MeasuredTimes:
    """The measured answer times, shape (n,) [s], the number of faults, and a record of the measurement."""

    avoider_name: str
    times_s: NDArray[np.float64]
    faults: int
    measured: Measured

    @property
    def profile(self) -> DecisionTimes:
        """The profile from which a scenario can draw its simulated decision times."""
        quantiles_s = self.quantiles_s(*np.linspace(0.0, 1.0, QUANTILES))
        return DecisionTimes(quantiles_s=tuple(quantiles_s), measured=self.measured)

    def quantiles_s(self, *shares: float) -> list[float]:
        """Return the quantiles [s] of the answer times for the given fractions."""
        return [float(np.quantile(self.times_s, share)) for share in shares]


def measured_times(reference: str, questions: int, seed: int) -> MeasuredTimes:
    """Measure an avoider's answer times, one question after another.

    If the avoider is a Python file, the function executes it.

    Args:
        reference: The avoider.
        questions: The number of questions.
        seed: The root of the questions.

    Raises:
        InadmissibleError: The avoider does not exist, or every answer is a fault.
        NoAnswerError: The avoider does not answer the first question in time.

    """
    scenario, place = scenario_of_avoider(reference), Place(field="AVOIDER")
    avoider = resolve_avoider(scenario, place)
    if not answers_at_first(avoider, *first_question(DEFAULTS)):
        raise NoAnswerError(avoider.name, FIRST_ANSWER_S)
    times_s, faults = answer_times_s(avoider, questions, seed)
    if faults == questions:
        raise InadmissibleError(place=place, expected="an avoider that answers", got="faults alone")
    file, name = file_and_name(reference)
    own = (Path(file).name + (f":{name}" if name else "")) if file else reference
    measured = Measured(avoider=own, sha256=avoider_sha256(scenario), machine=machine(), questions=questions)
    return MeasuredTimes(avoider.name, times_s, faults, measured)


def measured_controller(reference: str, scenario: Scenario, answers: int) -> MeasuredTimes:
    """Measure a controller's answer times in runs of ``scenario`` in the kinematic world.

    In these runs, the answers take no simulated time.

    Args:
        reference: The controller.
        scenario: The scenario.  The first run uses its seed, and each later run uses another seed.
        answers: The least number of answers to measure.

    Raises:
        InadmissibleError: The controller does not exist, or the scenario cannot be used.
        ControllerError: The controller fails in a run.

    """
    unhurried = replace(scenario.settings.avoidance, decision_time=DecisionCost.AS_DECLARED)
    settings = replace(scenario.settings, avoidance=unhurried)
    driven, admitter = with_avoider(replace(scenario, settings=settings), Driver(reference)), Admitter()
    times_s: list[float] = []
    while len(times_s) < answers:
        admitted = admitter.admit(replace(driven, seed=driven.seed + len(times_s)))
        if admitted.driver is None:
            expected = "a controller of yours, 'stop when near' or 'learned policy'"
            raise InadmissibleError.of_option("--controller", expected, f"{reference}, whose avoider answers")
        trace = run_trial(admitted, world=KINEMATIC)
        if trace.ended == INTERRUPTED:
            raise KeyboardInterrupt
        acts = acts_per_answer_of(admitted.driver.controller)
        # A controller may act several times on one answer.  The times of these calls add up to the answer's
        # time.
        times_s += np.add.reduceat(trace.answer_s, np.arange(0, len(trace.answer_s), acts)).tolist()
    component = named_system(driven).tested
    measured = Measured(
        avoider=component.name, sha256=component.sha256, machine=machine(), questions=len(times_s)
    )
    return MeasuredTimes(component.name, np.array(times_s), 0, measured)


def machine() -> str:
    """Return a text with the processor, the operating system and the Python version, for reports."""
    processor = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            models = [line.partition(":")[2].strip() for line in file if line.startswith("model name")]
        processor = models[0] if models else processor
    except OSError:
        pass
    text = f"{processor}, {os.cpu_count()} CPUs, {platform.system()}, Python {platform.python_version()}"
    return text if is_sentence(text) else platform.machine()


def answer_times_s(avoider: Avoider, questions: int, seed: int) -> tuple[NDArray[np.float64], int]:
    """Measure an avoider's answer times, shape (n,) [s], and count its faulty answers.

    The process that computes an answer also measures the time of the computation.

    Args:
        avoider: The avoider.
        questions: The number of questions.
        seed: The root of the random questions, which lie near the nominal hand and the desired TCP.

    """
    rng = generator(seed, Branch.DECISION_TIME, 0)
    hand = np.array(DEFAULTS.avoidance.nominal_hand_position_in_base_m)
    tcp = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
    answers = [
        ask(
            avoider,
            Question(
                hand + rng.uniform(-AROUND_M, AROUND_M, 3),
                tcp + rng.uniform(-AROUND_M, AROUND_M, 3),
                int(rng.integers(2**63)),
            ),
        )
        for _ in range(questions)
    ]
    return np.array([answer.latency_s for answer in answers]), sum(bool(reply.fault) for reply in answers)
