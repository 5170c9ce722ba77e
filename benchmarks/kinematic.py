"""How fast is the kinematic world, judging included?  Run: python benchmarks/kinematic.py [--episodes N].

Both worlds run the very same scenarios, drawn from an unseen space, in turns within one process, so that a
busy machine slows both; a ratio is formed within each turn and printed as median (least to greatest).
With ``--episodes`` that many more are drawn, run and judged, in one process and then in two at a time,
beside what two processes can do that need nothing but the processor.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import gc
import multiprocessing
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numba
import numpy as np
from admitted_points import admit_points
from loop import Recorded, naive_loop, naive_time
from ratios import Ratio, say

from safety_harness.admission.admit import Admitted
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_many, run_trial
from safety_harness.claims.properties.base import Property
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.space.read import read_space
from safety_harness.space.space import ScenarioSpace
from safety_harness.trace.trace import Trace

SPACES = Path(__file__).parents[1] / "scenarios" / "spaces"
DURATION_S = 4.0  # 500 control ticks
SCENARIOS = 24
REPEATED = 4  # runs of the kinematic world in a turn, since it is so much quicker
TURNS = 5
SCALE_TURNS = 3
SPINS = 500_000_000  # half a second or so
NAIVE = 3  # scenarios of the naive loop
BLOCK = 256  # points whose values are drawn at once
AIMED_RATIO, AIMED_OF_ALL, AIMED_SCALING, AIMED_MINUTES = 80.0, 40.0, 1.8, 9.0


def space_named(name: str) -> ScenarioSpace:
    """One of the shipped spaces."""
    return read_space(SPACES / f"{name}.yaml")


def shortened(admitted: Admitted) -> Admitted:
    """The same for DURATION_S."""
    return replace(admitted, scenario=replace(admitted.scenario, duration_s=DURATION_S))


def block_of(space: ScenarioSpace, number: int, size: int = BLOCK) -> list[Admitted]:
    """Block ``number`` of the draws, without those that cannot be tried."""
    u = np.random.default_rng([7, number]).random((size, space.dimension))
    seeds = range(number * size, (number + 1) * size)
    return [shortened(one) for one in admit_points(space, u, seeds) if isinstance(one, Admitted)]


def catalogue_for(admitted: Admitted) -> tuple[Property, ...]:
    """Every property of the catalogue, by its example."""
    claims = (Claim(sentence=entry.example, expected=Verdict.HOLDS) for entry in CATALOGUE)
    return tuple(property_of(claim, admitted.scenario) for claim in claims)


def judge_all(traces: Sequence[Trace], properties: Sequence[tuple[Property, ...]]) -> None:
    """Every property of every trace."""
    for trace, of_trace in zip(traces, properties, strict=True):
        for prop in of_trace:
            prop.evaluate(trace)


def seconds(work: Callable[[], object]) -> float:
    """How long it takes."""
    begun_s = time.perf_counter()
    work()
    return time.perf_counter() - begun_s


def measured(
    scenarios: list[Admitted], properties: Sequence[tuple[Property, ...]]
) -> tuple[list[float], list[float]]:
    """Milliseconds an episode of both worlds, in turns, each judging what it ran: PyBullet, kinematic."""
    engine, kinematic = [], []

    def engine_turn() -> None:
        judge_all([run_trial(one) for one in scenarios], properties)

    def kinematic_turn() -> None:
        for _ in range(REPEATED):
            judge_all(list(run_many(scenarios)), properties)

    kinematic_turn()  # warm
    for _ in range(TURNS):
        engine.append(1e3 * seconds(engine_turn) / len(scenarios))
        kinematic.append(1e3 * seconds(kinematic_turn) / len(scenarios) / REPEATED)
    return engine, kinematic


def compare(scenarios: list[Admitted], properties: Sequence[tuple[Property, ...]], words: str) -> None:
    """Both worlds in turns, printed."""
    engine, kinematic = measured(scenarios, properties)
    ratio = [a / b for a, b in zip(engine, kinematic, strict=True)]
    print(f"\n{words}")
    say("PyBullet", engine, "ms an episode")
    say("kinematic", kinematic, "ms an episode")
    say("ratio", ratio, f"(aim {AIMED_RATIO:g}: {met(median(ratio) >= AIMED_RATIO)})")


def split(space: ScenarioSpace, scenarios: list[Admitted]) -> None:
    """Where the time of an episode goes, from drawing to judging."""
    rows: dict[str, list[float]] = {"draw and admit": [], "run": [], "judge its claims": [], "judge all": []}
    everything = [catalogue_for(one) for one in scenarios]
    for turn in range(TURNS):
        begun_s = time.perf_counter()
        drawn = block_of(space, 1000 + turn, 64)
        rows["draw and admit"].append(1e6 * (time.perf_counter() - begun_s) / len(drawn))
        begun_s = time.perf_counter()
        traces = list(run_many(scenarios))
        rows["run"].append(1e6 * (time.perf_counter() - begun_s) / len(scenarios))
        claimed = [one.properties for one in scenarios]
        rows["judge its claims"].append(1e6 * seconds(lambda: judge_all(traces, claimed)) / len(scenarios))  # noqa: B023
        fresh = [replace(trace) for trace in traces]
        rows["judge all"].append(1e6 * seconds(lambda: judge_all(fresh, everything)) / len(scenarios))  # noqa: B023
    print("\nwhere the time of an episode goes")
    for name, values in rows.items():
        say(name, values, "us")


@dataclass(frozen=True)
class Rate:
    """What one process has done, from drawing to judging."""

    episodes: int
    wall_s: float
    processor_s: float
    most_mb: float


def campaign(name: str, blocks: Sequence[int]) -> Rate:
    """Draw, run and judge blocks of episodes."""
    space = space_named(name)
    judged(block_of(space, 0, 8))
    gc.collect()
    gc.freeze()  # what is loaded stays: a collection need not look at it again
    wall_s, processor_s, done = time.perf_counter(), time.process_time(), 0
    for number in blocks:
        done += judged(block_of(space, number))
    wall_s, processor_s = time.perf_counter() - wall_s, time.process_time() - processor_s
    return Rate(done, wall_s, processor_s, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)


def judged(scenarios: list[Admitted]) -> int:
    """Run and judge by their own claims; how many."""
    for one, trace in zip(scenarios, run_many(scenarios), strict=True):
        for prop in one.properties:
            prop.evaluate(trace)
    return len(scenarios)


def scale(name: str, episodes: int) -> None:
    """One process, then two with as many blocks each, in turns, and what the machine lets two do."""
    blocks = max(episodes // (2 * BLOCK * SCALE_TURNS), 1)
    halves = [(name, range(blocks)), (name, range(blocks, 2 * blocks))]
    ones, twos, ceilings = [], [], []
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        pool.map(spinning, [SPINS, SPINS], chunksize=1)  # both processes are there, and warm
        pool.starmap(campaign, [(name, range(1))] * 2, chunksize=1)
        for _ in range(SCALE_TURNS):
            (one,) = pool.starmap(campaign, halves[:1], chunksize=1)
            both = pool.starmap(campaign, halves, chunksize=1)
            alone_s, together_s = (max(pool.map(spinning, [SPINS] * n, chunksize=1)) for n in (1, 2))
            ones.append(one.episodes / one.wall_s)
            twos.append(sum(rate.episodes for rate in both) / max(rate.wall_s for rate in both))
            ceilings.append(2.0 * alone_s / together_s)
    scaling = [two / one for one, two in zip(ones, twos, strict=True)]
    minutes = [1e6 / two / 60.0 for two in twos]
    print(f"\n{name}: drawn, admitted, run and judged by its own claims, {SCALE_TURNS} turns")
    say("one process", ones, f"episodes a second, {one.most_mb:.0f} MB at most")
    say("two processes", twos, f"episodes a second, {max(rate.most_mb for rate in both):.0f} MB each")
    processor_ms = 1e3 * sum(rate.processor_s for rate in both) / sum(rate.episodes for rate in both)
    print(f"  processor time          {processor_ms:10.2f} ms an episode")
    say("scaling", scaling, f"(aim {AIMED_SCALING:g}: {met(max(scaling) >= AIMED_SCALING)} at best)")
    say("of a loop in registers", ceilings, "times with two processes: no program scales better here now")
    words = f"(aim {AIMED_MINUTES:g}: {met(min(minutes) <= AIMED_MINUTES)} at best)"
    say("a million episodes", minutes, f"minutes on two cores {words}")


def spinning(count: int) -> float:
    """Seconds that ``count`` steps of a generator take which needs no memory."""
    _spin(1)
    return seconds(lambda: _spin(count))


@numba.njit
def _spin(count: int) -> int:
    state = 1
    for _ in range(count):
        state = (state * 6364136223846793005 + 1442695040888963407) & 0x7FFFFFFFFFFFFFFF
    return state


def naive(scenarios: list[Admitted], properties: Sequence[tuple[Property, ...]]) -> None:
    """The loop of ``loop.py`` that renders, for information."""
    recorded = [Recorded(one, run_trial(one)) for one in scenarios[:NAIVE]]
    rendered_ms = []
    for one in recorded:
        with naive_loop(one.admitted) as loop:
            if loop is None:
                print("\nnaive rendered loop       skipped: torch is not installed")
                return
            rendered_ms.append(1e3 * naive_time(loop, one) * one.admitted.scenario.ticks)
    judge_all(list(run_many(scenarios)), properties)
    judged_s = min(seconds(lambda: judge_all(list(run_many(scenarios)), properties)) for _ in range(TURNS))
    ratio = median(rendered_ms) / (1e3 * judged_s / len(scenarios))
    print(f"\nnaive rendered loop, not judged, of {NAIVE} scenarios")
    say("naive loop", rendered_ms, "ms an episode")
    print(f"  ratio                   {ratio:10.0f} times the kinematic world, judged by the whole catalogue")


def met(aim: bool) -> str:
    """Whether an aim was met."""
    return "met" if aim else "NOT MET"


def ratios() -> list[Ratio]:
    """PyBullet over the kinematic world, judged by few claims and by all."""
    scenarios = block_of(space_named("unseen-both"), 0, 2 * SCENARIOS)[:SCENARIOS]
    rows = []
    for words, properties, aim in (
        ("its space's claims", [one.properties for one in scenarios], AIMED_RATIO),
        ("the whole catalogue", [catalogue_for(one) for one in scenarios], AIMED_OF_ALL),
    ):
        engine, kinematic = measured(scenarios, properties)
        each = [a / b for a, b in zip(engine, kinematic, strict=True)]
        note = f"kinematic {median(kinematic):.1f} ms an episode"
        rows.append(Ratio.of(f"an episode, PyBullet over kinematic ({words})", each, aim=aim, note=note))
    return rows


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--space", default="unseen-both", help="a shipped space")
    parser.add_argument("--episodes", type=int, default=4096, help="for the rates of one and two processes")
    given = parser.parse_args()
    space = space_named(given.space)
    scenarios = block_of(space, 0, 2 * SCENARIOS)[:SCENARIOS]
    traces = list(run_many(scenarios))
    critical_m = [one.scenario.settings.avoidance.critical_distance_m for one in scenarios]
    near = [
        float((trace.ticks["predicted_distance_m"] < limit_m).mean())
        for trace, limit_m in zip(traces, critical_m, strict=True)
    ]
    decisions = np.mean([len(trace.decisions) for trace in traces])
    print(
        f"{given.space}: {len(scenarios)} scenarios of {scenarios[0].scenario.ticks} ticks, "
        f"{np.mean(near):.1%} of them critical, {decisions:.2f} decisions each"
    )
    gc.collect()
    gc.freeze()
    compare(scenarios, [one.properties for one in scenarios], "judged by the space's own claims")
    compare(scenarios, [catalogue_for(one) for one in scenarios], "judged by the whole catalogue")
    split(space, scenarios)
    naive(scenarios, [catalogue_for(one) for one in scenarios])
    scale(given.space, given.episodes)


if __name__ == "__main__":
    main()
