"""What does it cost that a user's avoider is asked in another process?  Run: python benchmarks/isolation.py.

With ``--onnx FILE`` the avoider is that of an ONNX file, else the Python file of the example.

The same avoider here and there take turns, so that a busy machine slows both; values are median (least to
greatest) over the turns.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from ratios import Ratio, say

from safety_harness.base.exceptions import Place
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.asking import Question, ask
from safety_harness.cell.avoidance.avoider import Avoider, Proposal
from safety_harness.cell.avoidance.isolation.isolated import IsolatedAvoider, isolated_avoider, isolated_onnx
from safety_harness.cell.avoidance.onnx_model import OnnxAvoider

FILE = Path(__file__).parents[1] / "examples" / "upwards.py"
TURNS, ONE_BY_ONE, IN_ONE_MESSAGE, BEGUN = 9, 1_000, 256, 5
HAND, TCP = np.array([0.9, 0.1, 0.3]), np.array([0.7, 0.0, 0.35])


class Upwards:
    """The avoider of the file, in this process."""

    name = "straight up"

    def propose(
        self, *, hand_position_in_base_m: np.ndarray, tcp_position_in_base_m: np.ndarray, seed: int
    ) -> Proposal:
        """As there."""
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1])


def one_by_one(avoider: Avoider) -> None:
    """As a run asks."""
    for seed in range(ONE_BY_ONE):
        ask(avoider, Question(HAND, TCP, seed))


def microseconds(what: Callable[[], object], count: int) -> float:
    """For one of ``count``."""
    begun_s = time.perf_counter()
    what()
    return (time.perf_counter() - begun_s) / count * 1e6


def here_and_there(onnx: Path | None = None) -> tuple[Avoider, IsolatedAvoider]:
    """The same avoider in this process and in another."""
    if onnx is None:
        return Upwards(), isolated_avoider(FILE, "Upwards", Place())
    return OnnxAvoider.load(onnx, onnx.read_bytes(), hand=HAND, tcp=TCP), isolated_onnx(onnx, DEFAULTS)


def measured(here: Avoider, there: IsolatedAvoider) -> list[tuple[float, float, float]]:
    """Microseconds a question in turns: here, there, there and many in one message."""
    questions = [Question(HAND, TCP, seed, 10.0) for seed in range(IN_ONE_MESSAGE)]
    one_by_one(there)
    return [
        (
            microseconds(lambda: one_by_one(here), ONE_BY_ONE),
            microseconds(lambda: one_by_one(there), ONE_BY_ONE),
            microseconds(lambda: there.answers(questions, together=True), IN_ONE_MESSAGE),
        )
        for _ in range(TURNS)
    ]


def begun_anew(there: IsolatedAvoider) -> list[float]:
    """Milliseconds from the end of a process to the first answer of the next."""
    question, begun = Question(HAND, TCP, 0, 10.0), []
    for _ in range(BEGUN):
        there._connection.end()
        begun.append(microseconds(lambda: there.answers([question], together=False), 1) / 1e3)
    return begun


def ratios() -> list[Ratio]:
    """A question in another process over one in this; one by one over many in one message."""
    turns = measured(*here_and_there())
    note = f"{min(there for _, there, _ in turns):.0f} us"
    return [
        Ratio.of("a question, in another process over in this one", [b / a for a, b, _ in turns], note=note),
        Ratio.of("questions to another process, one by one over together", [b / c for _, b, c in turns]),
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--onnx", type=Path)
    here, there = here_and_there(parser.parse_args().onnx)
    turns = measured(here, there)
    say("one question, in this process", [turn[0] for turn in turns], "us")
    say("one question, in another", [turn[1] for turn in turns], "us")
    say(f"one of {IN_ONE_MESSAGE} questions in one message", [turn[2] for turn in turns], "us")
    say("a process begun anew, up to its first answer", begun_anew(there), "ms")


if __name__ == "__main__":
    main()
