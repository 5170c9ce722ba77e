"""Write benchmarks/STUDENT.md: the students in every shipped space, beside `optimum` and `mc-dropout`.

Run: python benchmarks/student_in_spaces.py [--draws N] (some minutes).  The same draws for all, in the
kinematic world, with the visual servo and its gate.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import subprocess
from dataclasses import replace
from pathlib import Path

from shipped_controllers import NEAR, STREAM, row

from safety_harness.admission.admit import Admitter
from safety_harness.admission.avoiders import with_avoider
from safety_harness.admission.spaces import draw_admissible
from safety_harness.admission.trial import run_kinematic
from safety_harness.space.read import read_space
from safety_harness.trace.overruling import Overruling
from safety_harness.trace.trace import Trace

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).with_name("STUDENT.md")
AVOIDERS = ("student", "student-ensemble", "optimum", "mc-dropout")
HEAD = """\
# The students in the shipped spaces

Written by `make bench-student_in_spaces` at {revision}: {draws} draws of each space (stream {stream}), the
same for all, kinematic world, visual servo with its gate. *Violated*: runs in which "{near}"
is; *limits*: runs in which a speed or joint limit is; *nearest*: the least distance of a hand in a run,
median over the runs; *arrived*: runs in which the TCP comes within 20 mm of the desired position, and after
how long (median of those); *off*: its distance from there at the end, median. *Overruled*: of the avoider's
proposals, those that the gate did not take.

| space | avoider | violated | limits | nearest | arrived | after | off | overruled |
|---|---|---|---|---|---|---|---|---|
"""


def main() -> None:
    """Run them all, and write the page."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=60)
    draws: int = parser.parse_args().draws
    git = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    revision = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    rows, admitter = [], Admitter()
    for path in sorted((ROOT / "scenarios" / "spaces").glob("*.yaml")):
        drawn = list(draw_admissible(read_space(path), STREAM, draws).scenarios)
        for avoider in AVOIDERS:
            traces: list[Trace] = [
                run_kinematic(admitter.admit(with_avoider(replace(one, claims=()), avoider))) for one in drawn
            ]
            shown, _ = row(path.stem, avoider, iter(traces))
            gate = Overruling.from_traces(traces)
            rows.append(f"{shown} {gate.replaced + gate.stopped:,} of {gate.proposals:,} |")
            print(rows[-1], flush=True)
    head = HEAD.format(revision=revision, draws=draws, stream=STREAM, near=NEAR)
    PAGE.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
