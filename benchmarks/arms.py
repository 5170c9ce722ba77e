"""Arms of other makers through the whole harness.  Run: python benchmarks/arms.py.

For each arm the space of ``docs/how-to/robot.md``, around the arm's shipped scenario: N random scenarios
of it in both worlds, judged by the whole catalogue, and a search by ``safety-harness fuzz``.  A verdict
counts as outside the limit as in ``agreement.py``: a margin is more than 5 mm from zero, or is no length.
Prints the tables of ``ARMS.md``; disagreements are listed below them.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from admitted_points import admit_points
from agreement import NEAR_M, Tally, compare, properties_of

from safety_harness.admission.admit import Admitted
from safety_harness.admission.trial import run_many
from safety_harness.space.read import read_space

ARMS = ("panda", "iiwa14", "xarm6", "ur10e")
SPACE = """\
scenario space: a hand comes near the arm, from where no training went
extends: shipped:robot-{arm}
without: [converged to the desired pose]
duration: 8 s
tcp start:
  offset: {{in: seen tcp}}
hands:
  - hand: right hand
    starts at: [1000 mm, -900 mm, 100 mm]
    elbow towards: [1400 mm, -1200 mm, 300 mm]
    moves:
      - wait: from 100 ms to 2 s
      - move to: {{in: unseen hand}}
        speed: from 0.2 m/s to 1.6 m/s
      - wait: from 100 ms to 2 s
      - withdraw: from 0.2 m/s to 1.6 m/s
"""


def random_ones(space_file: Path, count: int, seed: int) -> list[Admitted]:
    """``count`` scenarios of the space that can be run."""
    space, rng, found = read_space(space_file), np.random.default_rng(seed), list[Admitted]()
    while len(found) < count:
        missing = count - len(found)
        u = rng.random((missing, space.dimension))
        tried = admit_points(space, u, rng.integers(0, 2**62, missing).tolist())
        found += [one for one in tried if isinstance(one, Admitted)]
    return found


def catalogue(scenarios: list[Admitted]) -> dict[str, Counter[str]]:
    """How often each claim holds, is violated or neither, in the kinematic world."""
    found: dict[str, Counter[str]] = {}
    for admitted in scenarios:
        (trace,) = run_many([admitted])
        for prop in properties_of(admitted):
            found.setdefault(prop.sentence, Counter())[prop.evaluate(trace).verdict.value] += 1
    return found


def fuzzed(space_file: Path, budget: int) -> tuple[str, ...]:
    """Episodes, violated of those with a verdict, first after, and lying apart, of the main claim."""
    command = ["-m", "safety_harness", "fuzz", str(space_file), "--budget", str(budget), "--json"]
    command += ["--out", str(space_file.parent / f"{space_file.stem}-fuzz")]
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise SystemExit(done.stderr)
    result = json.loads(done.stdout)["result"]
    main = result["claims"][0]
    apart = len(list((space_file.parent / f"{space_file.stem}-fuzz").glob("*.yaml")))
    judged = f"{main['violated']} of {main['with_a_verdict']}"
    return str(result["tried"]), judged, str(main["first_violation_after"] or "-"), str(apart)


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("arms", nargs="*", default=ARMS, metavar="ARM")
    parser.add_argument("--random", type=int, default=50, help="scenarios of each arm")
    parser.add_argument("--budget", type=int, default=200, help="episodes of each search")
    given = parser.parse_args()
    rows, verdicts, listed = [], dict[str, dict[str, Counter[str]]](), list[str]()
    for number, arm in enumerate(given.arms):
        begun_s = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"{arm}.yaml"
            file.write_text(SPACE.format(arm=arm))
            drawn, tally = random_ones(file, given.random, number), Tally()
            compare(iter(drawn), tally)
            verdicts[arm] = catalogue(drawn)
            compared, agreed = tally.compared.total(), tally.agreed.total()
            apart_mm = 1e3 * tally.largest["TCP position [m]"].largest
            rows.append(
                (
                    arm,
                    f"{agreed} of {compared}",
                    f"{tally.near_agreed} of {tally.near}",
                    f"{apart_mm:.2g}",
                    *fuzzed(file, given.budget),
                )
            )
            listed += tally.disagreements
        print(f"{arm}: {time.perf_counter() - begun_s:.0f} s", file=sys.stderr, flush=True)
    near_mm = f"{1e3 * NEAR_M:g} mm"
    print(
        f"| arm | same verdict beyond {near_mm} | within {near_mm} | TCPs apart, mm "
        "| episodes | violated | first | lie apart |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for row in rows:
        print(f"| {' | '.join(row)} |")
    print("\n| claim | " + " | ".join(verdicts) + " |")
    print("|---|" + "---|" * len(verdicts))
    for sentence in next(iter(verdicts.values())):
        cells = (
            f"{count['holds']} / {count['violated']} / {count['inconclusive']}"
            for count in (of_arm[sentence] for of_arm in verdicts.values())
        )
        print(f"| {sentence} | {' | '.join(cells)} |")
    print("\n".join(["", f"disagreements: {len(listed)}", *listed]))


if __name__ == "__main__":
    main()
