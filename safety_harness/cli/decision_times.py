"""``safety-harness time``: how long an avoider takes to answer on this machine; a profile for scenarios."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import FIRST_ANSWER_S, answers_at_first, first_question
from safety_harness.admission.avoiders import avoider_sha256, resolve_avoider, scenario_of_avoider
from safety_harness.avoidance.asking import ask
from safety_harness.avoidance.avoider import Avoider
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, INTERRUPTED, explain, result, say
from safety_harness.exceptions import InadmissibleError, InputError, NoAnswerError, OutputError, Place
from safety_harness.report.words import milliseconds_words
from safety_harness.scenario.decision_times import profile_text
from safety_harness.scenario.fields import is_sentence
from safety_harness.scenario.references import file_and_name
from safety_harness.seeds import Branch, generator
from safety_harness.settings import DEFAULTS, DecisionTimes, Measured
from safety_harness.whole_file import write_whole

QUANTILES = 101  # from the quickest answer to the slowest
AROUND_M = 0.15  # the nominal hand and the desired TCP, on each axis


def time_avoider(reference: str, *, out: Path | None = None, questions: int = 1_000, seed: int = 0) -> int:
    """Ask, one question after another, print the quantiles, write the profile; returns the exit code."""
    try:
        if out is not None and out.suffix != ".json":
            raise InadmissibleError(place=Place(field="--out"), expected="a file *.json", got=out.name)
        scenario = scenario_of_avoider(reference)
        avoider = resolve_avoider(reference, scenario, folder=None, place=Place(field="AVOIDER"))
        if not answers_at_first(avoider, *first_question(DEFAULTS)):
            raise NoAnswerError(avoider.name, FIRST_ANSWER_S)
        times_s, faults = answer_times_s(avoider, questions, seed)
        if faults == questions:
            raise InadmissibleError(
                place=Place(field="AVOIDER"), expected="an avoider that answers", got="faults alone"
            )
        file, name = file_and_name(reference)
        own = (Path(file).name + (f":{name}" if name else "")) if file else reference
        measured = Measured(
            avoider=own, sha256=avoider_sha256(scenario), machine=machine(), questions=questions
        )
        quantiles_s = np.quantile(times_s, np.linspace(0.0, 1.0, QUANTILES))
        profile = DecisionTimes(quantiles_s=tuple(quantiles_s.tolist()), measured=measured)
        if out is not None:
            _write(profile, out)
    except InputError as error:
        explain(error)
        return BAD_INPUT
    except NoAnswerError as error:
        say(f"error: {error}; nothing was written")
        return BAD_INPUT
    except KeyboardInterrupt:
        say("interrupted: nothing was written")
        return INTERRUPTED
    p50, p99, most = (milliseconds_words(float(np.quantile(times_s, q))) for q in (0.5, 0.99, 1.0))
    result(f"{own} ({avoider.name}): p50 {p50}, p99 {p99}, max {most}, of {questions:,} answers")
    result(f"on {measured.machine}")
    if faults:
        say(f"note: {faults} of them were faults, no usable answers")
    if out is not None:
        say(f"profile: {out}; in a scenario: settings: {{avoidance: {{decision time: {out.name}}}}}")
    return AS_EXPECTED


def machine() -> str:
    """Processor, system and Python, as reports name them."""
    processor = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            found = [line.partition(":")[2].strip() for line in file if line.startswith("model name")]
        processor = found[0] if found else processor
    except OSError:
        pass
    words = f"{processor}, {os.cpu_count()} CPUs, {platform.system()}, Python {platform.python_version()}"
    return words if is_sentence(words) else platform.machine()


def answer_times_s(avoider: Avoider, questions: int, seed: int) -> tuple[NDArray[np.float64], int]:
    """(n,) the times of the answers [s], in the process in which they are made, and how many were faults."""
    rng = generator(seed, Branch.DECISION_TIME, 0)
    hand = np.array(DEFAULTS.avoidance.nominal_hand_position_in_base_m)
    tcp = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
    answers = [
        ask(
            avoider,
            hand_position_in_base_m=hand + rng.uniform(-AROUND_M, AROUND_M, 3),
            tcp_position_in_base_m=tcp + rng.uniform(-AROUND_M, AROUND_M, 3),
            seed=int(rng.integers(2**63)),
        )
        for _ in range(questions)
    ]
    return np.array([answer.latency_s for answer in answers]), sum(bool(one.fault) for one in answers)


def _write(profile: DecisionTimes, out: Path) -> None:
    try:
        write_whole(out, profile_text(profile))
    except OSError as error:
        raise OutputError.of(out, error) from error
