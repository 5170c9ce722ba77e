"""Do the intervals of the statistics hold as often as they say?  Run: python benchmarks/interval_coverage.py.

Prints nominal against measured coverage of every interval: exactly, by enumeration of every count, where
that can be done, otherwise over simulated samples; and of some broken intervals, which the measure must see.
An interval whose misses are more than its nominal chance explains (one in a thousand) is marked, and the exit
code is 1 if any is that claims to be exact.  --quick takes a tenth of the samples.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.special import ndtri

from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.extensions.assurance.statistics.binomial import Sides, bounds_of, ends_of
from safety_harness.extensions.assurance.statistics.distances import tolerance_bound
from safety_harness.extensions.assurance.statistics.importance import Importance, weigh
from safety_harness.extensions.assurance.statistics.paired import compare
from safety_harness.extensions.assurance.statistics.rare import Splitting, split
from safety_harness.extensions.assurance.statistics.sample import (
    Declaration,
    EpisodeOutcome,
    IndependentSample,
)
from safety_harness.extensions.assurance.statistics.sequential import evidence_apart, evidence_below

Floats = NDArray[np.float64]
HELD, VIOLATED = int(EpisodeOutcome.HOLDS), int(EpisodeOutcome.VIOLATED)


@dataclass(frozen=True)
class Row:
    """``samples`` is 0 where every count was enumerated; ``exact`` whether the interval claims to be."""

    interval: str
    setting: str
    nominal: float
    covered: float
    samples: int
    exact: bool = True

    @property
    def broken(self) -> bool:
        """Are the misses more than the nominal chance explains?"""
        if not self.samples:
            return self.covered < self.nominal - 1e-9
        missed = round((1.0 - self.covered) * self.samples)
        return bool(stats.binomtest(missed, self.samples, 1.0 - self.nominal, "greater").pvalue < 1e-3)

    def markdown(self) -> str:
        """One row of the table."""
        how = f"{self.samples:,} samples" if self.samples else "enumerated"
        mark = "" if not self.broken else " **too low**"
        return f"| {self.interval} | {self.setting} | {self.nominal:.1%} | {self.covered:.2%}{mark} | {how} |"


def declared(planned: int, **changes: object) -> Declaration:
    """A declaration of so many episodes."""
    hashes = {"plan_sha256": "0" * 64, "draws_sha256": "1" * 64}
    return Declaration(**(hashes | {"stratum": "s", "seed": 1, "planned": planned} | changes))  # type: ignore[arg-type]


def told(codes: NDArray[np.int64]) -> dict[str, NDArray[np.int64]]:
    """A seed for each run, and an occasion for each that was tested."""
    seeds = np.arange(codes.size).reshape(codes.shape)
    return {"seeds": seeds, "exercised": (codes != EpisodeOutcome.UNTESTED).astype(np.int64)}


def sample_of(
    codes: NDArray[np.int64], margins: Floats | None = None, **changes: object
) -> IndependentSample:
    """A sample of outcomes (n,), with margins that only suit them if none are given."""
    any_of_the_sign = np.select([codes == HELD, codes == VIOLATED], [1.0, -1.0], np.nan)
    signed = any_of_the_sign if margins is None else margins
    declaration = declared(len(codes), **changes)
    return IndependentSample.of_stream(declaration, np.arange(len(codes)), codes, signed, **told(codes))


def violations(count: int, trials: int) -> IndependentSample:
    """A sample in which the first ``count`` of ``trials`` runs violate."""
    return sample_of(np.where(np.arange(trials) < count, VIOLATED, HELD))


def with_margins(margins: Floats) -> IndependentSample:
    """A sample whose outcomes are the signs of its margins (n,)."""
    return sample_of(np.where(margins < 0.0, VIOLATED, HELD), margins)


def binomials(times: int) -> Iterator[Row]:
    """One-sided, two-sided, and Wald's for comparison, at the truths that matter and at the worst of many."""
    del times
    worst = np.concatenate([np.geomspace(1e-5, 0.5, 400), 1.0 - np.geomspace(1e-5, 0.5, 400)])
    for trials in (50, 300, 3000):
        counts = np.arange(trials + 1)
        upper = np.array([upper_bound(int(k), trials, 0.05) for k in counts])
        ends = np.array(
            [(lower_bound(int(k), trials, 0.025), upper_bound(int(k), trials, 0.025)) for k in counts]
        )
        seen = counts / trials
        wald = seen + stats.norm.isf(0.05) * np.sqrt(seen * (1.0 - seen) / trials)

        none = np.zeros(trials + 1)
        for share in (1e-3, 1e-2, 0.1):
            where, only = f"n = {trials}, p = {share:g}", np.array([share])
            yield Row("Clopper-Pearson, upper", where, 0.95, covered(none, upper, only), 0)
            yield Row("Wald, upper (broken)", where, 0.95, covered(none, wald, only), 0, exact=False)
        for name, low, high in (
            ("Clopper-Pearson, upper", none, upper),
            ("Clopper-Pearson, two-sided", ends[:, 0], ends[:, 1]),
        ):
            least = covered(low, high, worst)
            yield Row(name, f"n = {trials}, worst of 800 p", 0.95, least, 0)


def shown(times: int) -> Iterator[Row]:
    """What a report shows of plans: each interval alone, and all of them at once, margins beside them."""
    worst = np.concatenate([np.geomspace(1e-5, 0.5, 400), 1.0 - np.geomspace(1e-5, 0.5, 400)])
    for claims, strata in ((1, 1), (2, 2)):
        many = ends_of(claims, strata)
        for trials in (40, 300):
            made = [
                bounds_of([violations(k, trials)], 0.95, Sides.BOTH, family=many)[0]
                for k in range(trials + 1)
            ]
            low, high = (np.array([getattr(one, end) for one in made]) for end in ("low", "high"))
            one_sided = [
                (lower_bound(k, trials, 0.1 / many), upper_bound(k, trials, 0.1 / many))
                for k in range(trials + 1)
            ]
            lower, upper = np.array(one_sided).T
            where = f"{many} ends, n = {trials}, worst of 800 p"
            yield Row("interval on the page, alone", where, made[0].confidence, covered(low, high, worst), 0)
            before = covered(lower, upper, worst)
            name = "the same with an error for each interval, not each end (broken)"
            yield Row(name, where, made[0].confidence, before, 0, exact=False)
    rng, probabilities = np.random.default_rng(11), np.array([0.01, 0.03])
    sure, with_margins_too = 0, 0
    for _ in range(times):
        samples = []
        for _ in range(2):
            drawn = rng.random(300)
            samples += [with_margins(drawn - p) for p in probabilities]
        made = list(bounds_of(samples, 0.95, Sides.BOTH))
        held = all(b.low <= p <= b.high for b, p in zip(made, np.tile(probabilities, 2), strict=True))
        kept = all(
            tolerance_bound(one, content, made[0].confidence).at_least <= 1.0 - content - p
            for one, p in zip(samples, np.tile(probabilities, 2), strict=True)
            for content in (0.9, 0.99, 0.999)
        )
        sure += held
        with_margins_too += held and kept
    where = "2 claims x 2 strata, n = 300"
    yield Row("all 8 ends of the page at once", where, 0.95, sure / times, times)
    name = "the same, and 12 margins by order statistics (not promised)"
    yield Row(name, where, 0.95, with_margins_too / times, times, exact=False)


def covered(low: Floats, high: Floats, shares: Floats) -> float:
    """How often an interval (n + 1,), of each count, holds the share; the least over shares (m,)."""
    counts = np.arange(len(low))
    chances = stats.binom.pmf(counts, len(low) - 1, shares[:, None])
    inside = (low <= shares[:, None]) & (shares[:, None] <= high)
    return float(np.where(inside, chances, 0.0).sum(axis=1).min())


def families(times: int) -> Iterator[Row]:
    """All bounds of a plan at once: eight, of claims that are nested in each other."""
    rng, shares = np.random.default_rng(1), np.array([0.001, 0.003, 0.01, 0.03])
    together = 0
    samples = 2 * times
    for _ in range(samples):
        drawn = [np.where(rng.random(400)[:, None] < shares, VIOLATED, HELD) for _ in range(2)]
        bounds = bounds_of([sample_of(one[:, k]) for one in drawn for k in range(4)], 0.95, Sides.BOTH)
        together += all(b.low <= p <= b.high for b, p in zip(bounds, np.tile(shares, 2), strict=True))
    yield Row("Bonferroni, 16 ends", "2 strata x 4 claims, n = 400", 0.95, together / samples, samples)


def sequences(times: int) -> Iterator[Row]:
    """Looked at after every trial of 5,000, by an adversary who stops where it is worst."""
    trials = np.arange(1, 5001)
    limit = np.log(20.0)
    for share in (0.5, 0.1, 0.01, 0.001):
        rng, wrong = np.random.default_rng(2), np.zeros(4, np.int64)
        for _ in range(times):
            counts = np.cumsum(rng.random(len(trials)) < share)
            below = evidence_below(share, counts, trials)
            apart = evidence_apart(share, counts, trials)
            peeked = stats.binom.cdf(counts, trials, share) <= 0.05
            stopped = evidence_below(share / 1.02, counts, trials) >= limit
            wrong += [
                bool((below >= limit).any()),
                bool(((apart >= limit) & (counts > share * trials)).any()),
                bool(stopped.any()),
                bool(peeked.any()),
            ]
        held = 1.0 - wrong / times
        where = f"p = {share:g}, every n up to 5,000"
        yield Row("anytime, upper", where, 0.95, held[0], times)
        yield Row("anytime, lower", where, 0.95, held[1], times)
        yield Row("anytime, stopped once p/1.02 seems shown", where, 0.95, held[2], times)
        yield Row("Clopper-Pearson, peeked at (broken)", where, 0.95, held[3], times, exact=False)


def rare(times: int) -> Iterator[Row]:
    """The intervals over replications, of problems with known answers."""
    runs = max(times // 2, 20)

    def tail(points: Floats) -> Floats:
        return np.asarray(ndtri(np.maximum(points[:, 0], 1e-300)))

    def radius(points: Floats) -> Floats:
        return np.asarray(np.linalg.norm(ndtri(np.maximum(points, 1e-300)), axis=1))

    def along(points: Floats) -> Floats:
        return np.asarray(ndtri(np.maximum(points, 1e-300)).sum(axis=1) / np.sqrt(points.shape[1]))

    known: list[tuple[str, Callable[[Floats], Floats], int, float]] = [
        (f"{s} sigma", lambda u, s=s: s - tail(u), 2, float(stats.norm.sf(s)))  # type: ignore[misc]
        for s in (2, 3, 4)
    ]
    known.append(("4 sigma, both tails", lambda u: 4.0 - np.abs(tail(u)), 2, 2.0 * float(stats.norm.sf(4))))
    known.append(("outside r = 8, 30-d", lambda u: 8.0 - radius(u), 30, float(stats.chi2.sf(64, 30))))
    beyond = [float(stats.norm.isf(1.0 - (1.0 - 1e-4) ** (1.0 / k))) for k in (6, 10)]
    for k, far in zip((6, 10), beyond, strict=True):
        known.append((f"any of {k} half spaces", partial(nearest_half_space, far), k, 1e-4))
    for k, far in ((6, 4.2), (12, 4.3)):
        known.append(
            (f"outside {k} faces", partial(nearest_face, far), k // 2, k * float(stats.norm.sf(far)))
        )
    for d in (3, 6):
        ball = float(np.sqrt(stats.chi2(d).isf(1e-4)))
        known.append((f"outside a ball, {d}-d", lambda u, r=ball: r - radius(u), d, 1e-4))  # type: ignore[misc]
    known.append(
        ("4.5 sigma along a diagonal, 15-d", lambda u: 4.5 - along(u), 15, float(stats.norm.sf(4.5)))
    )
    few, usual = Splitting(particles=100, steps=3, replications=8), Splitting(particles=200)
    cases = (
        [(*one, usual) for one in known[:5]] + [(*known[2], few)] + [(*one, Importance()) for one in known]
    )
    for name, margins, dimensions, truth, how in cases:
        if isinstance(how, Importance):
            samples, estimated = runs, partial(weigh, how=how)
            kind = f"importance, {how.runs} after a pilot of {how.pilot} a step"
        else:
            samples = max(runs * 6 // 100, 20) if dimensions > 2 else runs
            estimated = partial(split, how=how)
            kind = f"splitting, {how.replications} of {how.particles} particles, {how.steps} steps"
        found = [estimated(margins, dimensions, seed=k) for k in range(samples)]
        values = np.array([one.value for one in found]) / truth
        spent = np.mean([one.evaluations for one in found])
        silent = np.mean([bool(one.no_estimate) for one in found])
        low = np.mean([one.value < truth / 2 for one in found if not one.no_estimate] or [0.0])
        where = (
            f"{name}, p = {truth:.2g}; mean {values.mean():.3f} p, deviation {values.std():.3f} p, "
            f"{spent:,.0f} points, {silent:.1%} without an estimate, "
            f"{low:.1%} of the estimates below half of the truth"
        )
        ends = np.array([(one.low, one.high) for one in found])
        held = float(np.mean((ends[:, 0] <= truth) & (truth <= ends[:, 1])))
        yield Row(kind, where, 0.95, held, samples, exact=False)
        upper = float(np.mean(ends[:, 1] >= truth))
        yield Row(f"{kind}: upper end", where, 0.975, upper, samples, exact=False)


def nearest_half_space(beyond: float, points: Floats) -> Floats:
    """Margins (n,) of points (n, d): how far the largest coordinate of normal space is from ``beyond``."""
    return np.asarray(beyond - ndtri(np.maximum(points, 1e-300)).max(axis=1))


def nearest_face(beyond: float, points: Floats) -> Floats:
    """Margins (n,) of points (n, d): how far inside a cube of half-width ``beyond`` in normal space."""
    return np.asarray(beyond - np.abs(ndtri(np.maximum(points, 1e-300))).max(axis=1))


def pairs(times: int) -> Iterator[Row]:
    """Differences of violation probabilities."""
    for first, second in ((0.01, 0.01), (0.05, 0.01), (0.2, 0.1), (0.002, 0.0)):
        rng, held, rejected = np.random.default_rng(3), 0, 0
        for _ in range(times):
            drawn = rng.choice(3, 500, p=[first, second, 1.0 - first - second])
            codes = [np.where(drawn == which, VIOLATED, HELD) for which in (0, 1)]
            found = compare(sample_of(codes[0]), sample_of(codes[1]))
            held += found.low <= first - second <= found.high
            rejected += found.p_value <= 0.05
        where = f"n = 500, only first {first:g}, only second {second:g}"
        yield Row("difference in violations", where, 0.95, held / times, times)
        if first == second:
            yield Row("McNemar, no false alarm", where, 0.95, 1.0 - rejected / times, times)


def margins(times: int) -> Iterator[Row]:
    """Tolerance bounds."""
    for n, content in ((300, 0.99), (3000, 0.99), (300, 0.9)):
        rng, held = np.random.default_rng(6), 0
        for _ in range(times):
            found = tolerance_bound(with_margins(rng.lognormal(size=n)), content)
            held += found.at_least <= stats.lognorm.ppf(1.0 - content, 1.0)
        yield Row("tolerance bound", f"n = {n}, content {content:.0%}", 0.95, held / times, times)


def main() -> int:
    """Print the table; 1 if an exact interval covers too seldom."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a tenth of the samples")
    times = 200 if parser.parse_args().quick else 2000
    print("| interval | setting | nominal | measured | by |\n|---|---|---|---|---|")
    broken = []
    for part in (binomials, shown, families, sequences, margins, pairs, rare):
        start = time.perf_counter()
        for row in part(times):
            print(row.markdown(), flush=True)
            if row.exact and row.broken:
                broken.append(row)
        print(f"{part.__name__}: {time.perf_counter() - start:.0f} s", file=sys.stderr)
    for row in broken:
        print(f"exact, and too low: {row.interval}, {row.setting}", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
