"""Where the processor's time of a campaign's episode goes, part by part.  Writes benchmarks/PARTS.md.

Run: python benchmarks/parts.py [FILE.md] [--against FOLDER] [--turns N] [--episodes N].

Episodes of 500 ticks of `unseen-both` with three claims, 64 at a time, as ``million.py`` runs them, in a
process of their own each turn; the checkout in FOLDER takes turns with this one.  Below, an avoider of a
user's file that answers many questions in one call, and one that does not, beside the shipped one.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

HERE = Path(__file__).resolve()
OUT, BATCH = HERE.with_name("PARTS.md"), 64
PARTS = ("draw", "admit", "run", "judge", "ledger")
AVOIDER = """
import numpy as np
from safety_harness import Proposal
AWAY_M = np.array([-0.02, 0.07, 0.07])
class {name}:
    name = "{name}"
    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        return Proposal(position_in_base_m=tcp_position_in_base_m + AWAY_M, spread_m=np.full(3, 0.005))
"""
MANY = """
    def propose_many(self, hands_in_base_m, tcps_in_base_m, seeds):
        return tcps_in_base_m + AWAY_M, np.full((len(seeds), 3), 0.005)
"""


def parts_of(episodes: int, avoider: str | None) -> dict[str, float]:
    """Milliseconds of the processor an episode, of each part, least of the batches."""
    from million import plan_in

    from safety_harness.admission.trial import run_all
    from safety_harness.base.exceptions import InputError
    from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner, root_seed
    from safety_harness.extensions.assurance.campaign.ledger import Ledger
    from safety_harness.extensions.assurance.campaign.plan import read_plan

    with tempfile.TemporaryDirectory() as folder:
        plan = plan_in(Path(folder), episodes)
        if avoider is not None:
            plan.file.write_text(plan.file.read_text().replace("world:", f"avoider: {avoider}\nworld:"))
            plan = read_plan(plan.file)
        runner, least = EpisodeRunner(plan), dict.fromkeys(PARTS, float("inf"))
        with Ledger.create(Path(folder) / "ledger.sqlite", plan) as ledger:
            for first in range(0, episodes, BATCH):
                times = [time.process_time()]
                group = range(first, first + BATCH)
                values = plan.strata[0].space.values_of_draws([root_seed(plan, 0, k) for k in group], 0)
                drawn = [runner.scenario(0, k, 0, row) for k, row in zip(group, values, strict=True)]
                times.append(time.process_time())
                admitted = []
                for one in drawn:
                    try:
                        admitted.append(runner._admitter.admit(one))
                    except InputError:  # another draw would take its place
                        continue
                times.append(time.process_time())
                runs = list(run_all(admitted, plan.world))
                times.append(time.process_time())
                rows = [runner.row_of(0, first + k, 1, run) for k, run in enumerate(runs)]
                times.append(time.process_time())
                ledger.record(rows)
                times.append(time.process_time())
                for part, begun, ended in zip(PARTS, times[:-1], times[1:], strict=True):
                    if first:  # the first compiles and loads
                        least[part] = min(least[part], 1e3 * (ended - begun) / len(admitted))
        return least


def turn(checkout: Path, episodes: int, avoider: str | None = None) -> dict[str, float]:
    """In a process of its own, with the package of that checkout."""
    env = os.environ | {"PYTHONPATH": f"{checkout}{os.pathsep}{checkout / 'benchmarks'}"}
    code = f"import sys; sys.path.insert(0, {str(HERE.parent)!r}); import parts, json; "
    code += f"print(json.dumps(parts.parts_of({episodes}, {avoider!r})))"
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def revision(checkout: Path) -> str:
    """As git says."""
    git = ["git", "-C", str(checkout), "describe", "--always", "--dirty"]
    return subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()


def rows(sides: dict[str, list[dict[str, float]]]) -> Iterator[str]:
    """Medians of the turns, each with its least."""
    yield f"| | {' | '.join(PARTS)} | together |"
    yield f"|---|{'---|' * (len(PARTS) + 1)}"
    for name, turns in sides.items():
        columns = [[one[part] for one in turns] for part in PARTS] + [[sum(one.values()) for one in turns]]
        yield f"| {name} | " + " | ".join(f"{median(one):.2f} ({min(one):.2f})" for one in columns) + " |"


def main() -> None:
    """Both tables, printed and written."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", nargs="?", type=Path, default=OUT, help="where the tables go")
    parser.add_argument("--against", type=Path, help="another checkout, in turns with this one")
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=8 * BATCH)
    given = parser.parse_args()
    here = HERE.parents[1]
    checkouts = {f"this one, {revision(here)}": here}
    if given.against is not None:
        checkouts[f"that one, {revision(given.against)}"] = given.against.resolve()
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        avoiders = {"mc-dropout, which ships": None}
        for name, more in (("Many", MANY), ("Each", "")):
            file = Path(folder) / f"{name.lower()}.py"
            file.write_text(AVOIDER.format(name=name) + more)
            words = "with propose_many" if more else "with propose alone"
            avoiders[f"a Python file {words}"] = f"{file}:{name}"
        sides: dict[str, list[dict[str, float]]] = {name: [] for name in (*checkouts, *avoiders)}
        for _ in range(given.turns):
            for name, checkout in checkouts.items():
                sides[name].append(turn(checkout, given.episodes))
            for name, avoider in avoiders.items():
                sides[name].append(turn(here, given.episodes, avoider))
    first = list(rows({name: sides[name] for name in checkouts}))
    second = list(rows({name: sides[name] for name in avoiders}))
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    loads = f"load {load:.1f} at the beginning and {os.getloadavg()[0]:.1f} at the end"
    head = (
        f"Written by `make bench-parts`. {machine}, Python {platform.python_version()}, {loads};",
        f"{given.turns} turns of {given.episodes} episodes. Milliseconds of the processor an episode of",
        "500 ticks, of the batches of a turn the least; of the turns the median (least). A user's file",
        "answers in a process of its own, whose time is not in it.",
    )
    text = "\n".join(
        (
            "# Where an episode's time goes",
            "",
            *head,
            "",
            *first,
            "",
            *second,
        )
    )
    print(text)
    given.file.write_text(text + "\n")


if __name__ == "__main__":
    main()
