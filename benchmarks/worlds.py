"""Do three worlds agree?  Run: python benchmarks/worlds.py [--random N] [--seed S] [--write].

Every shipped scenario that needs no renderer, and N random ones of the shipped spaces with four arms, in
PyBullet, MuJoCo and the kinematic world, judged by their own claims and by the whole catalogue.  Then a
visit with motors of less and less torque, where physics must show.  --write keeps the tables in WORLDS.md.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from agreement import differences, properties_of, random_ones, shipped
from results import revision

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry, world_named
from safety_harness.extensions.worlds.mujoco_entry import MUJOCO
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.trace import Trace

TABLE = Path(__file__).with_name("WORLDS.md")
EXAMPLES = Path(__file__).parents[1] / "examples" / "worlds"
WORLDS = (PYBULLET, MUJOCO, KINEMATIC)
SHARES = (1.0, 0.25, 0.22, 0.2, 0.15, 0.1)  # of the motors' torque limits
VISIT = "shipped:hand-visits-and-leaves"
ARMS = ("robot-iiwa14", "robot-panda", "robot-xarm6")  # scenarios of the cells of other arms


@dataclass
class Pair:
    """What two worlds made of the same scenarios."""

    verdicts: int = 0
    apart: list[str] = field(default_factory=list)
    largest: dict[str, float] = field(default_factory=dict)

    def take(self, admitted: Admitted, first: Trace, second: Trace) -> None:
        """Compare the runs of one scenario."""
        for prop in properties_of(admitted):
            one, other = prop.evaluate(first), prop.evaluate(second)
            self.verdicts += 1
            if one.verdict is not other.verdict:
                self.apart.append(
                    f"{admitted.scenario.name}: {one.sentence}: {one.verdict.value} ({one.margin_text()}), "
                    f"{other.verdict.value} ({other.margin_text()})"
                )
        for what, difference in differences(first, second).items():
            self.largest[what] = max(difference, self.largest.get(what, 0.0))


@dataclass
class Compared:
    """The pairs of worlds, the runs and ticks, and the time of each world."""

    pairs: dict[tuple[WorldEntry, ...], Pair]
    runs: int = 0
    ticks: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    physical: int = 0  # runs in which a motor saturated in MuJoCo
    arms: dict[str, tuple[int, float]] = field(default_factory=dict)  # runs, rad apart

    def take(self, admitted: Admitted) -> None:
        """Run a scenario in every world; one with rendered images is left out."""
        traces = {}
        try:
            MUJOCO.refuse(admitted.scenario)
        except InadmissibleError:
            return
        for world in WORLDS:
            begun_s = time.perf_counter()
            traces[world.name] = run_trial(admitted, world=world)
            spent_s = time.perf_counter() - begun_s
            self.seconds[world.name] = self.seconds.get(world.name, 0.0) + spent_s
        self.runs, self.ticks = self.runs + 1, self.ticks + len(traces["mujoco"].ticks)
        self.physical += bool(traces["mujoco"].overshoot_radps.any())
        arm, largest = admitted.scenario.robot.label, differences(traces["pybullet"], traces["mujoco"])
        runs, apart_rad = self.arms.get(arm, (0, 0.0))
        self.arms[arm] = runs + 1, max(apart_rad, largest["joint position [rad]"])
        for worlds, pair in self.pairs.items():
            pair.take(admitted, *(traces[world.name] for world in worlds))
        if self.runs % 50 == 0:
            print(f"  {self.runs} compared", file=sys.stderr, flush=True)

    def lines(self) -> Iterator[str]:
        """The table of pairs, and the times."""
        yield "| worlds | verdicts | apart | joints up to [rad] | TCP up to [m] | hand distance up to [m] |"
        yield "|---|---|---|---|---|---|"
        for worlds, pair in self.pairs.items():
            largest = " | ".join(f"{value:.2g}" for value in [*pair.largest.values()][:3])
            names = " and ".join(world.label for world in worlds)
            yield f"| {names} | {pair.verdicts:,} | {len(pair.apart)} | {largest} |"
        yield ""
        times = (f"{world.label} {1e6 * self.seconds[world.name] / self.ticks:.0f}" for world in WORLDS)
        yield f"Microseconds a tick, with control and sensors: {', '.join(times)}."
        yield f"A motor saturated in {self.physical} of {self.runs:,} runs."
        yield ""
        yield "| arm | runs | joints of PyBullet and MuJoCo apart by up to [rad] |"
        yield "|---|---|---|"
        for arm, (runs, apart_rad) in sorted(self.arms.items(), key=lambda item: -item[1][0]):
            yield f"| {arm} | {runs:,} | {apart_rad:.2g} |"
        for worlds, pair in self.pairs.items():
            for line in pair.apart:
                yield f"- {' and '.join(world.label for world in worlds)}: {line}"


def of_arms(each: int, seed: int) -> Iterator[Admitted]:
    """``each`` random scenarios for each cell of ARMS: its arm and task, with the hands of a draw."""
    for number, name in enumerate(ARMS):
        cell, wanted = read_scenario(f"shipped:{name}"), each
        draws = list(random_ones(3 * wanted, seed + number + 1))  # space by space
        for k in np.random.default_rng(seed).permutation(len(draws)).tolist():
            drawn = draws[k].scenario
            changes = {"hands": drawn.hands, "seed": drawn.seed, "duration_s": drawn.duration_s}
            with suppress(InadmissibleError):
                yield admit(replace(cell, name=f"{cell.name}, {drawn.name}", **changes))
                wanted -= 1
            if not wanted:
                break


def times() -> Iterator[str]:
    """A table of the time of a tick of one visit in each world, and in the example simulators."""
    visit = admit(read_scenario(VISIT))
    yield "| world | microseconds a tick |"
    yield "|---|---|"
    with TemporaryDirectory() as folder:
        cell = f"{folder}/cell"
        subprocess.run(["cc", "-O2", "-o", cell, EXAMPLES / "kinematic_cell.c"], check=True)
        python = f"exec:{sys.executable} {EXAMPLES / 'kinematic_cell.py'}"
        simulators = {"a simulator in Python": python, "a simulator in C": f"exec:{cell}"}
        worlds = {str(world): world for world in WORLDS}
        worlds |= {name: world_named(command, "world") for name, command in simulators.items()}
        for name, world in worlds.items():
            run_trial(visit, world=world)  # begins what the next runs use
            begun_s, runs = time.perf_counter(), 5
            ticks = sum(len(run_trial(visit, world=world).ticks) for _ in range(runs))
            yield f"| {name} | {1e6 * (time.perf_counter() - begun_s) / ticks:.0f} |"


def weak_motors() -> Iterator[str]:
    """A table of one visit with motors of less torque, of which neither servo nor admission knows."""
    strong = admit(replace(read_scenario(VISIT), duration_s=2.0, claims=()))
    yield "| share of the torque limits | PyBullet and MuJoCo [rad] | MuJoCo and kinematic [rad] |"
    yield "|---|---|---|"
    for share in SHARES:
        weak = replace(strong, arm=replace(strong.arm, effort_limit=share * strong.arm.effort_limit))
        bullet, mujoco, kinematic = (run_trial(weak, world=world) for world in WORLDS)
        pairs = ((bullet, mujoco), (mujoco, kinematic))
        apart = (differences(*pair)["joint position [rad]"] for pair in pairs)
        yield f"| {share:g} | {' | '.join(f'{rad:.2g}' for rad in apart)} |"


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--random", type=int, default=1000, help="how many random scenarios")
    parser.add_argument("--each", type=int, default=50, help="how many more with each of three other arms")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.name}")
    given = parser.parse_args()
    compared = Compared({pair: Pair() for pair in combinations(WORLDS, 2)})
    for admitted in shipped():
        compared.take(admitted)
    from_files = compared.runs
    for admitted in (*random_ones(given.random, given.seed), *of_arms(given.each, given.seed)):
        compared.take(admitted)
    random = compared.runs - from_files
    text = "\n".join(
        [
            "# Three worlds",
            "",
            f"Written by `python benchmarks/worlds.py --write` at {revision()}.",
            "",
            "## Agreement",
            "",
            f"{from_files} shipped and {random:,} random scenarios of six spaces and four arms, judged by",
            "their claims and the whole catalogue.",
            "",
            *compared.lines(),
            "",
            "## Time of a tick",
            "",
            "With control, sensors and the motion between ticks, for one visit.",
            "",
            *times(),
            "",
            "## Motors that are too weak",
            "",
            "The largest difference of a joint's position in 2 s of a visit, while neither the control stack",
            "nor the admission of the scenario knows that the motors are weak.",
            "",
            *weak_motors(),
            "",
        ]
    )
    print(text)
    if given.write:
        TABLE.write_text(text)


if __name__ == "__main__":
    main()
