"""How long does a tick of the monitor take, for 1, 5 and 20 claims, beside rtamt's online mode?

Run: python benchmarks/monitor.py [SECONDS] prints the table of MONITOR.md.  A synthetic cell's stream, joints
at 125 Hz and a hand with its elbow at 30 Hz, goes through the monitor as fast as it takes it: for each tick
the lines that came since the one before, from JSON to verdicts.  *Formulas*: the claims alone, of a distance
with both its ends.  rtamt is handed the distance as one number, in the form that it has online for "always":
historically.  After each tick a loop of a fixed length is timed, which shows what the machine adds: *busy* is
its slowest part of a hundred over its median.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / "field" / "logs"), str(ROOT / "tests" / "field" / "monitoring")]

from cells import cell, recorded, said  # noqa: E402
from stream_lines import lines  # noqa: E402

from safety_harness.extensions.field.monitoring.cell import read_cell  # noqa: E402
from safety_harness.extensions.field.monitoring.monitor import Monitor  # noqa: E402
from safety_harness.extensions.field.monitoring.sensing import HAND_DISTANCE, MEASURED  # noqa: E402
from safety_harness.extensions.field.monitoring.watched import WatchedClaim  # noqa: E402

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    import rtamt

SECONDS = 40.0
PERIOD_S = 0.008
FIRST = 200  # ticks that are not counted
LOOP = 3_000  # steps of the loop of a fixed length
KINDS = (
    "always hand distance > {} mm",
    "always nearest hand to TCP > {} mm",
    "always (within 200 ms hand distance > {} mm)",
    "whenever hand distance < {} mm then within 200 ms TCP speed < 900 mm/s",
    "always TCP height > -{} mm",
)


def claims(count: int) -> list[str]:
    """So many, of five forms."""
    return [KINDS[k % len(KINDS)].format(40 + 10 * k) for k in range(count)]


def ticks(seconds: float) -> list[list[bytes]]:
    """The lines of a stream, up to each line with joints."""
    rng = np.random.default_rng(1)
    found: list[list[bytes]] = [[]]
    for line in lines(recorded(cell(rng), rng, seconds=seconds, clock_s=0.0), latency_s=0.03):
        found[-1].append(line)
        if b"joint_position_rad" in line:
            found.append([])
    return found[:-1]


def loop() -> None:
    """Of a fixed length."""
    total = 0
    for k in range(LOOP):
        total += k


def timed(works: Iterator[Callable[[], object]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) milliseconds of each: on the wall, of this thread's processor time, and of a loop after it."""
    rows = []
    for work in works:
        begin, own = time.perf_counter(), time.thread_time()
        work()
        end, own_end = time.perf_counter(), time.thread_time()
        loop()
        rows.append((end - begin, own_end - own, time.perf_counter() - end))
    wall, thread, fixed = 1e3 * np.array(rows[FIRST:]).T
    return wall, thread, fixed


def ours(count: int, stream: list[list[bytes]], folder: Path) -> Iterator[Callable[[], object]]:
    """A tick each."""
    (folder / "CELL.yaml").write_text(said("none.csv", "none.csv", "none.csv"))
    own = Monitor(cell=read_cell(folder / "CELL.yaml", claims(count)))

    def work(some: list[bytes]) -> Callable[[], object]:
        return lambda: [change for line in some for change in own.take(line)]

    yield from map(work, stream)
    assert own.counts.ticks > len(stream) - 3
    assert own.counts.refused == 0


def formulas(count: int, stream: list[list[bytes]]) -> Iterator[Callable[[], object]]:
    """The claims of a tick, of a distance alone."""
    watched = [
        WatchedClaim(f"always hand distance > {40 + 10 * k} mm", MEASURED, PERIOD_S, 1) for k in range(count)
    ]
    distances = np.random.default_rng(2).uniform(0.1, 1.0, len(stream))

    def work(tick: int) -> Callable[[], object]:
        low, high = distances[tick] - 0.05, distances[tick] + 0.05
        seen = np.zeros((1, len(MEASURED), 6))
        seen[0, HAND_DISTANCE] = distances[tick], low, high, low, high, 1.0
        return lambda: [claim.see(seen, tick, grown=True) for claim in watched]

    yield from map(work, range(len(stream)))


def theirs(count: int, stream: list[list[bytes]]) -> Iterator[Callable[[], object]]:
    """An update of each specification, of a distance."""
    specs = []
    for k in range(count):
        spec = rtamt.StlDiscreteTimeOnlineSpecification()
        spec.declare_var("x", "float")
        spec.spec = f"historically (x > {0.04 + 0.01 * k:.2f})"
        spec.parse()
        specs.append(spec)
    distances = np.random.default_rng(2).uniform(0.1, 1.0, len(stream))

    def work(at: int) -> Callable[[], object]:
        return lambda: [spec.update(at, [("x", float(distances[at]))]) for spec in specs]

    yield from map(work, range(len(stream)))


def row(name: str, count: int, times: tuple[np.ndarray, np.ndarray, np.ndarray]) -> str:
    """Of the table."""
    wall, thread, fixed = times
    parts = [f"{np.quantile(side, q):.3f}" for side, q in ((wall, 0.5), (wall, 0.99), (wall, 1.0))]
    parts += [f"{np.quantile(thread, q):.3f}" for q in (0.5, 0.99)]
    busy = f"{np.quantile(fixed, 0.99) / np.median(fixed):.1f}"
    return f"| {name} | {count} | " + " | ".join([*parts, busy]) + " |"


def main() -> None:
    """The table."""
    stream = ticks(float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS)
    print("| | claims | p50 | p99 | largest | processor p50 | processor p99 | busy |")
    print("|---|---|---|---|---|---|---|---|")
    with TemporaryDirectory() as folder:
        for count in (1, 5, 20):
            print(row("monitor", count, timed(ours(count, stream, Path(folder)))), flush=True)
            print(row("formulas", count, timed(formulas(count, stream))), flush=True)
            print(row("rtamt", count, timed(theirs(count, stream))), flush=True)


if __name__ == "__main__":
    main()
