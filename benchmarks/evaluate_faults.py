"""Does evaluate name faulty avoiders, and leave sound ones alone?  Writes benchmarks/EVALUATE.md.

Every fault of faulty_avoiders.py, at three magnitudes and on top of mc-dropout and of the closed form, is
scored once with the default counts, in a process of its own; it is named if a finding came that what is below
it does not have.  The shipped avoiders and the harmless changes are scored with 20 seeds each.

Each result is a line of --lines as soon as it is there, with the revision it was made at; what is there
already for a name and a seed is not made again, so that the whole (hours) may be stopped and started.
--what chooses a part; --table only writes the table.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import json
import multiprocessing
import os
import platform
import re
import resource
import subprocess
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np
from faulty_avoiders import BASES, FAULTS, HARMLESS, Fault, avoider_named, names, network

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.asking import BatchAvoider
from safety_harness.cell.avoidance.shipped import SHIPPED
from safety_harness.cell.avoidance.simple import NearestCandidate, OppositePose
from safety_harness.extensions.lab.scoring.findings import findings
from safety_harness.extensions.lab.scoring.questions import Questions
from safety_harness.extensions.lab.scoring.regions import QuestionRegion, named_regions
from safety_harness.extensions.lab.scoring.repeats import Subject
from safety_harness.extensions.lab.scoring.score import Counts, score, yardsticks
from safety_harness.extensions.lab.scoring.scorecard import Scorecard
from safety_harness.space.regions import paper_seen

OUT = Path(__file__).with_name("EVALUATE.md")
LINES = Path(__file__).parents[1] / "reports" / "evaluate_faults.jsonl"
NUMBER = re.compile(r"(?<![\w.])[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?(?!\w)")
SEEDS, MOST_CPU_S, WALL_LIMIT_S = 20, 60.0, 900.0
SLOW = ("late_", "hiccups", "slow_for_near_hands")  # asked as little as their pace asks for
SLOWEST = "nearest candidate"
OTHERS = ("opposite pose", SLOWEST)
SOUND = (*SHIPPED, *OTHERS, *(f"{one}_on_{base}" for one in HARMLESS for base in BASES))
BELOW = ("sound_on_network", "sound_on_optimum", "sound_with_spread_on_optimum")


@dataclass(frozen=True)
class Result:
    """What scoring one avoider came to: findings by kind and region in words, or what went wrong."""

    name: str
    seed: int
    revision: str
    findings: dict[str, str]
    cpu_s: float
    wall_s: float
    error: str = ""


def made(name: str) -> BatchAvoider:
    """The avoider called ``name`` here, with a memory of its own."""
    if name in SHIPPED:
        return network(name)
    if name in OTHERS:
        pose = OppositePose(DEFAULTS.avoidance.radius_m)
        return pose if name == "opposite pose" else NearestCandidate.for_cell(DEFAULTS)
    return avoider_named(name)


class Remembering(QuestionRegion):
    """A region that draws the same questions once: inverse kinematics takes most of a scoring's time."""

    def draw(self, rng: np.random.Generator, count: int) -> Questions:
        """As the region does, by the generator's state."""
        key = self.name, repr(rng.bit_generator.state), count
        if key not in DRAWN:
            DRAWN[key] = super().draw(rng, count)
        return DRAWN[key]


DRAWN: dict[tuple[str, str, int], Questions] = {}
REGIONS = tuple(Remembering(**vars(region)) for region in named_regions(paper_seen(DEFAULTS), DEFAULTS))


@cache
def yards(seed: int) -> tuple[tuple[Scorecard, ...], float]:
    """The yardsticks' scores, which are the same for all, and the processor time that they took."""
    spent_s = _spent_s()
    return yardsticks(REGIONS, seed=seed, counts=Counts()), _spent_s() - spent_s


def measured(name: str, seed: int, revision: str) -> Result:
    """Score it here; the processor time is that of all processes, with that of questions and yardsticks."""
    found: dict[str, str] = {}
    error, (against, yards_s) = "", yards(seed)
    begun_s, spent_s = time.perf_counter(), _spent_s()
    counts = None if any(slow in name for slow in SLOW) else Counts()
    try:
        card = score(Subject.made_by(lambda: made(name), name), REGIONS, seed=seed, counts=counts)
        for one in findings(card, against):
            key = one.kind.value + (f" ({one.region})" if one.region else "")
            found[key] = f"{found[key]}; {one.words}" if key in found else one.words
    except Exception as raised:  # of what is on trial, or of the scoring: a row of the table
        error = f"{type(raised).__name__}: {raised}"
    cpu_s = yards_s + _spent_s() - spent_s
    return Result(name, seed, revision, found, cpu_s, time.perf_counter() - begun_s, error)


def apart(name: str, seed: int, revision: str) -> Result:
    """Score it in a fork, which remembers nothing of another."""
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    child = context.Process(target=lambda: there.send(measured(name, seed, revision)))
    child.start()
    there.close()
    try:
        if here.poll(WALL_LIMIT_S):
            result: Result = here.recv()
            return result
        error = f"no end within {WALL_LIMIT_S:.0f} s"
    except EOFError:
        error = "the process ended"
    finally:
        child.kill()
        child.join()
    return Result(name, seed, revision, {}, np.nan, WALL_LIMIT_S, error)


def _spent_s() -> float:
    return sum(
        used.ru_utime + used.ru_stime
        for used in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def known(lines: Path) -> dict[tuple[str, int], Result]:
    """What was measured so far; the last line for a name and a seed counts."""
    if not lines.exists():
        return {}
    results = [Result(**json.loads(line)) for line in lines.read_text().splitlines()]
    return {(result.name, result.seed): result for result in results}


def tasks(what: str) -> Iterator[tuple[str, int]]:
    """Names and seeds: what is below, the slight faults, the others, then the sound ones seed after seed."""
    every = list(names())[::-1]  # the classes that are hardest to see come first
    if what in ("all", "faults", "slight"):
        yield from ((name, 0) for name in BELOW)
        yield from ((name, 0) for name in every if "_1_on_" in name)
    if what in ("all", "faults"):
        yield from ((name, 0) for name in every if "_1_on_" not in name)
    if what in ("all", "sound"):
        yield from ((name, seed) for seed in range(SEEDS) for name in SOUND if name != SLOWEST)
        yield from ((SLOWEST, seed) for seed in range(SEEDS))


# The table


def below(fault: Fault, base: str) -> str:
    """What a fault is on top of."""
    return f"sound_{'with_spread_' if fault.of_spread and base == 'optimum' else ''}on_{base}"


def new_of(result: Result, base: Result) -> list[str]:
    """The findings that what is below does not have."""
    return sorted(set(result.findings) - set(base.findings))


def cell(fault: Fault, level: int, base: str, results: dict[tuple[str, int], Result]) -> str:
    """What was found of one fault, or that it was not tried."""
    result = results.get((f"{fault.name}_{level}_on_{base}", 0))
    under = results.get((below(fault, base), 0))
    if result is None or under is None:
        return "not run"
    if result.error:
        return f"**error**: {result.error[:80]}"
    new = new_of(result, under)
    words = f"{', '.join(new[:3])}{f' and {len(new) - 3} more' if len(new) > 3 else ''}" or "**not named**"
    return f"{words} ({result.cpu_s:.0f} s, {letters(results)[result.revision]})"


def letters(results: dict[tuple[str, int], Result]) -> dict[str, str]:
    """A letter for each revision that something was measured at."""
    revisions = dict.fromkeys(result.revision for result in results.values())
    return dict(zip(revisions, "abcdefghijklmnopqrstuvwxyz", strict=False))


def fault_rows(results: dict[tuple[str, int], Result]) -> Iterator[str]:
    """A row for each fault and magnitude."""
    yield "| class | fault | magnitude | on mc-dropout | on the closed form |"
    yield "|---|---|---|---|---|"
    for fault in FAULTS.values():
        for level in (1, 2, 3):
            cells = (cell(fault, level, base, results) for base in BASES)
            yield f"| {fault.kind} | {fault.name} | {fault.told(level)} | {' | '.join(cells)} |"


def sound_rows(results: dict[tuple[str, int], Result]) -> Iterator[str]:
    """A row for each finding on a sound avoider: in how many seeds, and its figures."""
    yield "| avoider | finding | in seeds | figures |"
    yield "|---|---|---|---|"
    for name in SOUND:
        own = [result for (one, _), result in results.items() if one == name]
        words: dict[str, list[str]] = defaultdict(list)
        for result in own:
            said = {"error": result.error} if result.error else result.findings
            for kind, sentence in said.items():
                words[kind].append(sentence)
        if not words:
            yield f"| {name} | {'none' if own else 'not run'} | {len(own)} | |"
        for kind, every in sorted(words.items()):
            yield f"| {name} | {kind} | {len(every)} of {len(own)} | {ranged(every)} |"


def ranged(every: list[str]) -> str:
    """Sentences that differ in their numbers, as one with ranges; the first where they differ otherwise."""
    alike = [one for one in every if NUMBER.sub("#", one) == NUMBER.sub("#", every[0])]
    columns = zip(*(NUMBER.findall(one) for one in alike), strict=True)
    spans = iter([_span([(float(text.replace(",", "")), text) for text in column]) for column in columns])
    return NUMBER.sub(lambda _: next(spans), every[0])


def _span(values: list[tuple[float, str]]) -> str:
    least, most = min(values)[1], max(values)[1]
    return least if least == most else f"[{least} to {most}]"


def summary(results: dict[tuple[str, int], Result]) -> Iterator[str]:
    """How many were named, by magnitude, what was not, and how long it took."""
    for level in (1, 2, 3):
        run, named, missed = 0, 0, []
        for fault in FAULTS.values():
            for base in BASES:
                name = f"{fault.name}_{level}_on_{base}"
                result, under = results.get((name, 0)), results.get((below(fault, base), 0))
                if result is not None and under is not None:
                    run += 1
                    found = bool(new_of(result, under)) and not result.error
                    named += found
                    missed += [] if found else [name]
        most = f"; not named: {', '.join(missed)}" if missed else ""
        yield f"- magnitude {level}: {named} of {run} named, {2 * len(FAULTS) - run} not run{most}"
    spent = sorted(result.cpu_s for result in results.values()) or [0.0]
    over = sum(one > MOST_CPU_S for one in spent)
    yield (
        f"- processor time of a scoring: median {spent[len(spent) // 2]:.0f} s, most {spent[-1]:.0f} s; "
        f"more than {MOST_CPU_S:.0f} s in {over} of {len(results)}"
    )


def table(results: dict[tuple[str, int], Result]) -> str:
    """EVALUATE.md."""
    revisions = [f"{letter} {revision}" for revision, letter in letters(results).items()]
    yours = (
        "A fault is named if a finding came that what is below it does not have; in brackets the processor "
        "time and the revision. Magnitudes rise from slight to gross; the slight ones are wrong or hazardous "
        "too. Each can be tried: `safety-harness evaluate benchmarks/faulty_avoiders.py:NAME` (`python "
        "benchmarks/evaluate_faults.py --list` lists the names and says what each does)."
    )
    head = (
        f"Revisions: {', '.join(revisions)}. {platform.system()} {platform.machine()}, "
        f"{os.cpu_count()} CPUs, Python {platform.python_version()}."
    )
    parts = (
        "# Faulty avoiders, scored",
        f"Written by `make bench-evaluate_faults`. {head}",
        yours,
        "\n".join(summary(results)),
        "## Faults",
        "\n".join(fault_rows(results)),
        "## Sound avoiders and harmless changes",
        "\n".join(sound_rows(results)),
    )
    return "\n\n".join(parts) + "\n"


def described() -> str:
    """The revision."""
    command = ["git", "describe", "--always", "--dirty"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


def main() -> None:
    """Measure what is not there yet, and write the table as it grows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lines", type=Path, default=LINES, help="where results are kept")
    parser.add_argument("--out", type=Path, default=OUT, help="where the table goes")
    parser.add_argument("--what", choices=("all", "faults", "slight", "sound"), default="all")
    parser.add_argument("--only", default="", help="names that contain this")
    parser.add_argument("--part", type=int, default=0, help="of --parts, which may run beside each other")
    parser.add_argument("--parts", type=int, default=1)
    parser.add_argument("--table", action="store_true", help="measure nothing")
    parser.add_argument("--list", action="store_true", help="say what every fault does")
    given = parser.parse_args()
    if given.list:
        for fault in FAULTS.values():
            sizes = ", ".join(fault.told(level) for level in (1, 2, 3))
            print(f"{fault.name}_N_on_BASE ({fault.kind}; {sizes}): {fault.harm}")
        return
    results, revision = known(given.lines), described()
    todo = [task for task in tasks(given.what) if task not in results and given.only in task[0]]
    given.lines.parent.mkdir(parents=True, exist_ok=True)
    for name, seed in [] if given.table else todo[given.part :: given.parts]:
        yards(seed)  # before the fork, which has them then
        result = apart(name, seed, revision)
        results[name, seed] = result
        with given.lines.open("a") as file:
            file.write(json.dumps(asdict(result)) + "\n")
        print(f"{name} {seed}: {result.findings or result.error} {result.cpu_s:.0f} s", flush=True)
        given.out.write_text(table(results), encoding="utf-8")
    given.out.write_text(table(results), encoding="utf-8")


if __name__ == "__main__":
    main()
