"""How fast, how sound and how right attribution is.

Run: python benchmarks/whose_fault.py [--draws N] [--motions M] [--faults] [--seed S].

Of N draws of every shipped space that claims the hand distance, or is given it: how many violations there
are, whose fault they are, and how long that takes.  On each that is called unavoidable, M arm motions with
foresight are searched (foresight.py): none may keep the claim.  With --faults every seeded fault of the
self-test: which of the violations that it causes are attributed to the part that it sits in.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from foresight import best_distance_m

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.admission.spaces import draw_admissible
from safety_harness.claims.properties.hand_distance import HAND_DISTANCE
from safety_harness.extensions.attribution.attribute import Attribution, AttributionAnswer, attribute
from safety_harness.extensions.attribution.tally import AttributionTally
from safety_harness.extensions.selftest.attributed import INGREDIENTS, attribute_seeded
from safety_harness.extensions.selftest.catalogue import FAULTS
from safety_harness.extensions.selftest.fault import SeededFault
from safety_harness.extensions.selftest.suite import SelfTestPlan, profile_named
from safety_harness.extensions.selftest.trial import FaultTrials
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.space.read import read_space

SCENARIOS = Path(__file__).parents[1] / "scenarios"
LEAST_M = 0.05
CLAIM = Claim(sentence=HAND_DISTANCE.example, expected=Verdict.HOLDS)
NO_CLAIMS = ("the run can be carried through", "the same question has the same answer")


def main() -> None:
    """As the command line asks."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=300)
    parser.add_argument("--motions", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--faults", action="store_true")
    asked = parser.parse_args()
    if asked.faults:
        of_faults()
        return
    kept = 0
    for path in sorted((SCENARIOS / "spaces").glob("*.yaml")):
        kept += of_space(path, asked.draws, asked.motions, asked.seed)
    print(f"unavoidable, and kept by a motion with foresight: {kept}")


def of_space(path: Path, draws: int, motions: int, seed: int) -> int:
    """Prints a space's tally; how many that are called unavoidable a motion with foresight keeps."""
    admitter = Admitter()
    drawn = draw_admissible(read_space(path), seed, draws).scenarios
    admitted = [admitter.admit(replace(one, claims=(CLAIM,))) for one in drawn]
    attribute(admitted[0], [CLAIM])  # compiles what is not compiled
    found: list[tuple[Admitted, Attribution]] = []
    took_s, worst_s = 0.0, 0.0
    for one in admitted:
        begun_s = time.process_time()
        attributions = attribute(one)
        spent_s = time.process_time() - begun_s
        if attributions:
            took_s, worst_s = took_s + spent_s, max(worst_s, spent_s)
        found += [(one, each) for each in attributions]
    tally = AttributionTally.from_attributions(each for _, each in found)
    print(f"{path.stem}: {draws} draws", flush=True)
    if not found:
        print("  no violation")
        return 0
    print(*(f"  {line}" for line in tally.lines()), sep="\n")
    print(f"  {took_s / len(found) * 1e3:.0f} ms of processor time each, {worst_s * 1e3:.0f} ms at most")
    unavoidable = [one for one, each in found if each.answer is AttributionAnswer.UNAVOIDABLE]
    best = [best_distance_m(one, motions) for one in unavoidable]
    kept = sum(distance_m >= LEAST_M for distance_m in best)
    nearest = f", the best came to {max(best) * 1e3:.1f} mm" if best else ""
    print(f"  {len(best)} unavoidable, {kept} of them kept by one of {motions} motions{nearest}", flush=True)
    return kept


def of_faults() -> None:
    """Prints for every seeded fault how many violations it causes, and how many are laid at its part."""
    plan = SelfTestPlan(profile_named("quick"), SCENARIOS, None)
    trials = FaultTrials(plan.episodes())
    total, right = 0, 0
    for number, fault in enumerate(FAULTS):
        if fault.harmless or not trials.applies(fault):
            continue
        groups = Counter(one.group for one in of_fault(trials, fault))
        own = INGREDIENTS[fault.part].value
        total += sum(groups.values())
        right += groups[own]
        print(f"[{number + 1}/{len(FAULTS)}] {own}: {fault.name}: {dict(groups)}", flush=True)
    print(f"{right} of {total} to the right ingredient ({right / max(total, 1):.1%})")


def of_fault(trials: FaultTrials, fault: SeededFault) -> Iterator[Attribution]:
    """Whose fault the violations are that the largest magnitude causes in the first episode that shows it."""
    magnitude = fault.ladder.values[0]
    rung = trials.rung(fault, magnitude)
    sentences: Sequence[str] = [one.claim for one in rung.alarms if one.claim not in NO_CLAIMS]
    if sentences:
        claims = [Claim(sentence=sentence, expected=Verdict.HOLDS) for sentence in sentences]
        yield from attribute_seeded(fault, magnitude, trials.episodes[rung.episodes - 1], claims)


if __name__ == "__main__":
    main()
