"""Do the two worlds agree?  Run: python benchmarks/agreement.py [--random N] [--seed S] [--write].

Every shipped scenario, and N random ones of the shipped spaces, in both worlds, judged by their own claims
and by the whole catalogue.  A verdict counts as outside the limit where either world's margin is more than
5 mm from zero, or is no length.  Every disagreement is listed; *optimistic* ones, where only PyBullet sees
a violation, are the ones that matter for a search in the kinematic world.  Answers count however long they
take in both: it is the worlds that are compared, and no clocks.  --write keeps the outcome in the
package, where reports find it.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from admitted_points import admit_points

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.agreement import (
    AGREEMENT_FILE,
    FORMAT,
    Agreement,
    LargestDifference,
    present_source,
)
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_many, run_trial
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.claims.properties.answered import DecisionTime
from safety_harness.claims.properties.base import Evaluation, Property, Unit
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.scenario.expand import gather
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.space.read import read_space
from safety_harness.trace.trace import Trace

SCENARIOS = Path(__file__).parents[1] / "scenarios"
NEAR_M = 0.005
AIMED = 0.99


@dataclass
class Tally:
    """What was compared, and what came out."""

    runs: int = 0
    compared: Counter[str] = field(default_factory=Counter)  # by sentence, outside NEAR_M
    agreed: Counter[str] = field(default_factory=Counter)
    near: int = 0  # verdicts within NEAR_M of a limit
    near_agreed: int = 0
    disagreements: list[str] = field(default_factory=list)
    optimistic: list[str] = field(default_factory=list)
    largest: dict[str, LargestDifference] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)

    def take(self, admitted: Admitted, engine: Trace, kinematic: Trace) -> None:
        """Both worlds' traces of one scenario."""
        self.runs += 1
        name = admitted.scenario.name
        for prop in properties_of(admitted):
            self._compare(name, prop.evaluate(engine), prop.evaluate(kinematic))
        for what, difference in differences(engine, kinematic).items():
            if what not in self.largest or difference > self.largest[what].largest:
                self.largest[what] = LargestDifference(what, difference, name)

    def _compare(self, name: str, engine: Evaluation, kinematic: Evaluation) -> None:
        same = engine.verdict is kinematic.verdict
        words = (
            f"{name}: {engine.sentence}: PyBullet {engine.verdict.value} ({engine.margin_text()}), "
            f"kinematic {kinematic.verdict.value} ({kinematic.margin_text()})"
        )
        if near_a_limit(engine) and near_a_limit(kinematic):
            self.near += 1
            self.near_agreed += same
        else:
            self.compared[engine.sentence] += 1
            self.agreed[engine.sentence] += same
        if not same:
            self.disagreements.append(words)
            if engine.verdict is Verdict.VIOLATED:
                self.optimistic.append(words)


def near_a_limit(evaluation: Evaluation) -> bool:
    """Is it about a length, and within NEAR_M of its limit?"""
    margin = evaluation.margin
    return evaluation.unit is Unit.LENGTH and margin is not None and abs(margin) <= NEAR_M


def properties_of(admitted: Admitted) -> list[Property]:
    """The scenario's own claims and the catalogue's examples, but for the wall's clock."""
    known = {prop.sentence: prop for prop in admitted.properties}
    for entry in CATALOGUE:
        claim = Claim(sentence=entry.example, expected=Verdict.HOLDS)
        prop = property_of(claim, admitted.scenario)
        known.setdefault(prop.sentence, prop)
    return [prop for prop in known.values() if not isinstance(prop, DecisionTime)]


def differences(engine: Trace, kinematic: Trace) -> dict[str, float]:
    """Largest differences over the ticks of two traces, and at the same decisions."""
    a, b = engine.ticks, kinematic.ticks
    tcp = a["transform_tcp_to_base"][:, :3, 3] - b["transform_tcp_to_base"][:, :3, 3]
    present = a["hand_present"]
    distance = np.abs(a["hand_distance_m"][present] - b["hand_distance_m"][present])
    return {
        "joint position [rad]": float(np.abs(a["joint_position_rad"] - b["joint_position_rad"]).max()),
        "TCP position [m]": float(np.linalg.norm(tcp, axis=1).max()),
        "hand distance [m]": float(distance.max(initial=0.0)),
        "number of decisions": float(abs(len(engine.decisions) - len(kinematic.decisions))),
    }


def shipped() -> Iterator[Admitted]:
    """Every shipped scenario that needs no renderer."""
    for scenario in gather([SCENARIOS]).scenarios:
        yield admit(scenario)


def random_ones(count: int, seed: int) -> Iterator[Admitted]:
    """``count`` scenarios that can be tried, from every shipped space in turn."""
    spaces = [read_space(file) for file in sorted((SCENARIOS / "spaces").glob("*.yaml"))]
    for number, space in enumerate(spaces):
        wanted = count // len(spaces) + (number < count % len(spaces))
        rng = np.random.default_rng([seed, number])
        while wanted > 0:
            u = rng.random((wanted, space.dimension))
            for one in admit_points(space, u, rng.integers(0, 2**62, wanted).tolist()):
                if isinstance(one, Admitted):
                    wanted -= 1
                    yield one


def compare(scenarios: Iterator[Admitted], tally: Tally) -> None:
    """Run each in both worlds."""
    for admitted in scenarios:
        try:
            (kinematic,) = run_many([admitted])
        except InadmissibleError as error:
            tally.left_out.append(f"{admitted.scenario.name}: {error.place.field}: {error.got}")
            print(f"  left out: {tally.left_out[-1]}")
            continue
        tally.take(admitted, run_trial(admitted), kinematic)
        if tally.runs % 25 == 0:
            print(f"  {tally.runs} compared", file=sys.stderr, flush=True)


def agreement_of(tally: Tally, shipped: int, seed: int) -> Agreement:
    """What is kept of it."""
    return Agreement(
        source=present_source(),
        shipped=shipped,
        random=tally.runs - shipped,
        seed=seed,
        near_m=NEAR_M,
        compared=tally.compared.total(),
        agreed=tally.agreed.total(),
        compared_near=tally.near,
        agreed_near=tally.near_agreed,
        optimistic=tuple(tally.optimistic),
        disagreements=tuple(tally.disagreements),
        differences=tuple(tally.largest.values()),
        left_out=tuple(tally.left_out),
    )


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--random", type=int, default=500, help="how many random scenarios")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", action="store_true", help=f"write {AGREEMENT_FILE.name} into the package")
    given = parser.parse_args()
    present_source()  # of what runs, whatever is edited meanwhile
    tally, begun_s = Tally(), time.perf_counter()
    compare(shipped(), tally)
    from_files = tally.runs
    print(f"{from_files} shipped scenarios", flush=True)
    compare(random_ones(given.random, given.seed), tally)
    found = agreement_of(tally, from_files, given.seed)
    print(f"{tally.runs} scenarios in both worlds, {time.perf_counter() - begun_s:.0f} s")
    print(
        f"verdicts outside {NEAR_M * 1e3:g} mm of a limit: {found.agreed} of {found.compared} agree, "
        f"{found.share:.2%} (aim {AIMED:.0%}: {'met' if found.share >= AIMED else 'NOT MET'})"
    )
    print(f"verdicts within it: {found.agreed_near} of {found.compared_near} agree")
    for title, lines in (("optimistic", found.optimistic), ("all", found.disagreements)):
        print(f"{title} disagreements: {len(lines)}")
        for line in lines:
            print(f"  {line}")
    print("largest differences")
    for one in found.differences:
        print(f"  {one.what:24}{one.largest:10.3g}  {one.scenario}")
    if given.write:
        text = json.dumps({"format": FORMAT, **asdict(found)}, indent=1)
        AGREEMENT_FILE.write_text(text + "\n")


if __name__ == "__main__":
    main()
