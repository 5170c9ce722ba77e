"""What does a broken controller cost?  Writes benchmarks/BROKEN_PROGRAMS.md or FILE.md.

A program speaks the protocol for three ticks, and then sends one of 1,000 mutated frames, exits, hangs,
floods or takes memory.  After each such episode comes one in which it behaves.  An episode that comes to its
end on what is no answer, a next episode that differs by a bit from the undisturbed one, or a process that is
left behind ends the benchmark with an error.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import gc
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]

from tests.cell.controller.out_of_process.broken_runs import BrokenProgram  # noqa: E402
from tests.cell.controller.out_of_process.mutated_frames import MUTATIONS, is_an_answer  # noqa: E402

OUT = Path(__file__).with_name("BROKEN_PROGRAMS.md")
WAYS = ("exit", "killed", "hang", "flood", "flood of lines", "flood of errors", "memory")


def refuse_any_left() -> None:
    """After its controller is gone, no process that this one started is there."""
    gc.collect()
    left = Path(f"/proc/self/task/{os.getpid()}/children").read_text()
    assert not left, left


def main() -> None:
    """The table, printed and written."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", nargs="?", type=Path, default=OUT, help="where the table goes")
    parser.add_argument("--frames", type=int, default=1_000)
    parser.add_argument("--times", type=int, default=25, help="of each exit, hang and flood")
    given = parser.parse_args()
    begun_s, asked, refused = time.monotonic(), Counter[str](), Counter[str]()
    names = list(MUTATIONS)
    with tempfile.TemporaryDirectory() as folder:
        program = BrokenProgram(Path(folder), "says")
        for seed in range(given.frames):
            name = names[seed % len(names)]
            frame = MUTATIONS[name](random.Random(seed))
            why = program.episode(frame)
            assert (why and why.isprintable()) or is_an_answer(frame), (seed, frame[:200])
            asked[name] += 1
            refused[name] += bool(why)
        del program
        refuse_any_left()
        for way in WAYS:
            program = BrokenProgram(Path(folder), way)
            for _ in range(given.times):
                assert program.episode(b""), way
                asked[way] += 1
                refused[way] += 1
            del program
            refuse_any_left()
    revision = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False
    ).stdout.strip()
    rows = [f"| {name} | {asked[name]} | {refused[name]} | {asked[name] - refused[name]} |" for name in asked]
    text = "\n".join(
        (
            "# What a broken controller costs",
            "",
            f"Written by `make bench-broken_programs`, at {revision}, in {time.monotonic() - begun_s:.0f} s. "
            f"{asked.total():,} episodes with a fault, each followed by one without: "
            "bit-identical to the undisturbed one after every fault. No process was left behind.",
            "",
            "| what came at the fourth tick | episodes | errors with a reason | still an answer |",
            "|---|---|---|---|",
            *rows,
        )
    )
    print(text)
    given.file.write_text(text + "\n")


if __name__ == "__main__":
    main()
