"""Every shipped avoider gives the same bits alone, in batches of any size and order, and in another process.

On one machine: another family of processors may round otherwise.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.avoiders import NAMES
from safety_harness.admission.trial import run_kinematic, run_many
from safety_harness.trace.trace import Trace
from tests.examples import VISIT, scenario

SEEDS = (1, 2, 3)


def episodes(avoider: str) -> list[Admitted]:
    """The same visit with other draws, and of other lengths, so that they decide at other ticks."""
    return [admit(scenario(VISIT, duration_s=1.2 + 0.1 * seed, avoider=avoider, seed=seed)) for seed in SEEDS]


def digest(trace: Trace) -> str:
    """Of all bits of ticks and decisions, but the time that a decision took."""
    return hashlib.sha256(trace.ticks.tobytes() + trace.decisions.tobytes()).hexdigest()


def alone(admitted: Admitted) -> Trace:
    """Tick by tick."""
    return run_kinematic(admitted)


def print_digests() -> None:
    """In a process of its own: the last episode first, and in other batches."""
    for avoider in NAMES:
        traces = list(run_many(episodes(avoider)[::-1], ticks_at_once=200))
        print(avoider, *(digest(trace) for trace in traces[::-1]), sep="\t")


@pytest.fixture(scope="module")
def elsewhere() -> dict[str, list[str]]:
    program = "from tests.cell.simulation.test_bits_everywhere import print_digests; print_digests()"
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=root, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2_000:]
    lines = [line.split("\t") for line in done.stdout.splitlines()]
    return {avoider: found for avoider, *found in lines}


@pytest.mark.parametrize("avoider", NAMES)
def test_the_bits_are_the_same_alone_in_batches_and_in_a_fresh_process(
    avoider: str, elsewhere: dict[str, list[str]]
) -> None:
    traces = [alone(one) for one in episodes(avoider)]
    assert min(len(trace.decisions) for trace in traces) > 0
    found = [digest(trace) for trace in traces]
    assert len(set(found)) == len(SEEDS)
    for ticks_at_once in (1, 100_000):
        assert [digest(one) for one in run_many(episodes(avoider), ticks_at_once=ticks_at_once)] == found
    assert elsewhere[avoider] == found
