"""Does anything grow, and is every bit the same?  Run: python benchmarks/soak.py [--episodes N].

The same draws of a space go round and round in one process, in the kinematic world, judged by their claims.
Every round has to give the bits of the first.  Memory and open files are looked at after the first round, in
the middle and at the end; only then is it said that nothing grew.  Then the first round is made once more in
fresh processes, by other batch sizes and by the loop of one run at a time.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.spaces import draw_admissible
from safety_harness.admission.trial import TICKS_AT_ONCE, judge, run_kinematic, run_many
from safety_harness.space.read import read_space
from safety_harness.trace.trace import Trace

ROOT = Path(__file__).resolve().parents[1]
SPACE = ROOT / "scenarios" / "spaces" / "unseen-both.yaml"
DRAWS = 250
MOST_GROWTH_MB = 5.0  # of the resident set, from the middle to the end
BATCHES = (1, 5_000, TICKS_AT_ONCE, 200_000)  # ticks at once


def admitted_draws(count: int) -> list[Admitted]:
    """The draws that go round."""
    return [admit(scenario) for scenario in draw_admissible(read_space(SPACE), 0, count).scenarios]


def digest(traces: Iterable[Trace]) -> str:
    """Of all bits of ticks and decisions."""
    hashed = hashlib.sha256()
    for trace in traces:
        hashed.update(trace.ticks.tobytes())
        hashed.update(trace.decisions.tobytes())
    return hashed.hexdigest()


def alone(admitted: Admitted) -> Trace:
    """One run, tick by tick; no decision is late by the clock, as none of a batch is."""
    never_late = (False,) * (admitted.scenario.ticks + 1)
    return run_kinematic(admitted, controller=admitted.controller(never_late))


def round_of(draws: Sequence[Admitted]) -> tuple[str, int]:
    """The digest of one round, and how many verdicts were given."""
    hashed, verdicts = hashlib.sha256(), 0
    for trace in run_many(draws):
        hashed.update(trace.ticks.tobytes())
        hashed.update(trace.decisions.tobytes())
        verdicts += len(judge(trace))
    return hashed.hexdigest(), verdicts


def held() -> tuple[float, int]:
    """Resident memory [MB] and open files of this process, from the kernel's own account."""
    status = Path("/proc/self/status").read_text()
    kilobytes = next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS"))
    return int(kilobytes) / 1024, len(os.listdir("/proc/self/fd"))


def processor() -> str:
    """The family that the claim of identical bits is about."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")


def in_a_fresh_process(count: int) -> str:
    """The digest of a first round elsewhere."""
    done = subprocess.run(
        [sys.executable, __file__, "--digest", "--draws", str(count)],
        check=True,
        capture_output=True,
        text=True,
    )
    return done.stdout.strip()


def soak(draws: Sequence[Admitted], episodes: int) -> tuple[list[dict[str, float]], str, bool]:
    """Memory and files along the way, the first round's digest, and whether all rounds gave it."""
    rounds = max(3, -(-episodes // len(draws)))
    looks = {1, rounds // 2, rounds}
    seen: list[dict[str, float]] = []
    first, same, begun = "", True, time.monotonic()
    for number in range(1, rounds + 1):
        found, _ = round_of(draws)
        first = first or found
        same = same and found == first
        if number in looks:
            megabytes, files = held()
            done, seconds = number * len(draws), time.monotonic() - begun
            seen.append({"episodes": done, "rss_mb": round(megabytes, 1), "files": files})
            print(
                f"{done:>8} episodes  {megabytes:8.1f} MB  {files:3} open files  {seconds:7.0f} s", flush=True
            )
    return seen, first, same


def main() -> int:
    """Print, and write what was seen; 1 if anything grew or differed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100_000)
    parser.add_argument("--draws", type=int, default=DRAWS)
    parser.add_argument("--out", type=Path, help="the same as JSON")
    parser.add_argument("--digest", action="store_true", help="print the digest of the first round, no more")
    asked = parser.parse_args()
    draws = admitted_draws(asked.draws)
    if asked.digest:
        print(round_of(draws)[0])
        return 0
    print(f"processor: {processor()}")
    seen, first, same = soak(draws, asked.episodes)
    checks = {"every round the bits of the first": same}
    for ticks in BATCHES:
        checks[f"batches of {ticks} ticks"] = digest(run_many(draws, ticks_at_once=ticks)) == first
    checks["one run at a time"] = digest(alone(one) for one in draws) == first
    for number in (1, 2):
        checks[f"fresh process {number}"] = in_a_fresh_process(len(draws)) == first
    growth_mb = seen[-1]["rss_mb"] - seen[1]["rss_mb"]
    checks[f"memory grew by {growth_mb:+.1f} MB from the middle to the end"] = growth_mb <= MOST_GROWTH_MB
    checks["no more open files than in the beginning"] = seen[-1]["files"] <= seen[0]["files"]
    for words, fine in checks.items():
        print(f"{'ok  ' if fine else 'NOT '} {words}")
    if asked.out:
        found = {"processor": processor(), "digest": first, "looks": seen, "checks": checks}
        asked.out.write_text(json.dumps(found, indent=1) + "\n")
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    raise SystemExit(main())
