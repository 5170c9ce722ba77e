"""How long do ``always`` and bounded ``eventually`` take on 10,000 samples, here and in rtamt?

Run: python benchmarks/formulas.py.  Both begin with the samples, as an array here and as the lists that rtamt
reads, and end with the margin at every sample; formulas are read, and code compiled, before.  The two
are measured in turn, the fastest of several rounds counts, and the margins are compared.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import time
import warnings
from collections.abc import Callable

import numpy as np
from ratios import Ratio

from safety_harness.claims.formulas.formula import Comparison, Formula, Truth
from safety_harness.claims.formulas.language import always, eventually, hand_distance, mm, s
from safety_harness.claims.formulas.semantics import MarginBounds, comparison_bounds, margins

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    import rtamt

SAMPLES = 10_000
PERIOD_S = 0.008
ROUNDS, REPEATS = 5, 20  # ours is repeated within a round, to be longer than the clock's steps
AIM = 200.0
SEED = 1
NEAR = hand_distance() > mm(50)
FORMULAS: tuple[tuple[str, Formula, str], ...] = (
    ("always", always(NEAR), "always (x > 0.05)"),
    ("eventually within 0.2 s", eventually(NEAR, window=s(0.2)), "eventually[0,25] (x > 0.05)"),
    ("eventually within 0.8 s", eventually(NEAR, window=s(0.8)), "eventually[0,100] (x > 0.05)"),
    ("always for 0.8 s", always(NEAR, window=s(0.8)), "always[0,100] (x > 0.05)"),
)


def seconds(work: Callable[[], object], repeats: int) -> float:
    """Of one call."""
    begin_s = time.perf_counter()
    for _ in range(repeats):
        work()
    return (time.perf_counter() - begin_s) / repeats


def measured(formula: Formula, text: str, x: np.ndarray) -> tuple[list[float], list[float]]:
    """Seconds of one evaluation in each round, ours and rtamt's."""

    def atoms(atom: Comparison | Truth) -> MarginBounds:
        assert isinstance(atom, Comparison)
        return comparison_bounds(atom, x, x)

    def ours() -> np.ndarray:
        return margins(formula, atoms, PERIOD_S).bounds.low

    spec = rtamt.StlDiscreteTimeSpecification()
    spec.declare_var("x", "float")
    spec.spec = text
    spec.parse()
    data = {"time": [float(k) for k in range(len(x))], "x": x.tolist()}

    def theirs() -> list[list[float]]:
        return spec.evaluate(data)

    decided = np.isfinite(low := ours())
    assert decided.sum() >= len(x) - 101
    assert np.array_equal(low[decided], np.array(theirs())[decided, 1])
    own_s, their_s = [], []
    for _ in range(ROUNDS):
        own_s.append(seconds(ours, REPEATS))
        their_s.append(seconds(theirs, 1))
    return own_s, their_s


def samples() -> np.ndarray:
    """(SAMPLES,) of a signal about its limit."""
    x: np.ndarray = 0.1 + 0.05 * np.random.default_rng(SEED).normal(size=SAMPLES)
    return x


def ratios() -> list[Ratio]:
    """What rtamt takes over what ours takes, round by round."""
    rows, x = [], samples()
    for name, formula, text in FORMULAS:
        own_s, their_s = measured(formula, text, x)
        each = [b / a for a, b in zip(own_s, their_s, strict=True)]
        note = f"ours {1e6 * min(own_s):.0f} us"
        rows.append(Ratio.of(f"formula, rtamt over ours ({name})", each, aim=AIM, note=note))
    return rows


def main() -> None:
    """Print a line for each formula."""
    x = samples()
    print(f"{SAMPLES:,} samples, the margin at every one; the aim is a ratio of {AIM:g}")
    print(f"{'formula':<24} {'ours':>10} {'rtamt':>10} {'ratio':>7}")
    for name, formula, text in FORMULAS:
        own_s, their_s = (min(each) for each in measured(formula, text, x))
        ratio = their_s / own_s
        verdict = "" if ratio >= AIM else "  (missed)"
        print(f"{name:<24} {own_s * 1e6:>7.0f} us {their_s * 1e3:>7.1f} ms {ratio:>7.0f}{verdict}")


if __name__ == "__main__":
    main()
