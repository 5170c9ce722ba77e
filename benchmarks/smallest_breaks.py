"""Measure the smallest break that each claim catches.  Run: nice python benchmarks/smallest_breaks.py.

Each family of ``breaks_of_claims`` is a run that is sound at one magnitude and broken at another one.  The
magnitude is bisected for the smallest at which the claim says *violated* and an own oracle does too
(``own_oracles``).  A claim that says it of a run in which the oracle finds nothing raises an error.
Writes docs/smallest-breaks.json after each family, and skips those that this source has measured; ``python
docs/tables.py`` shows it.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from math import ceil, floor, log10
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), *(str(ROOT / name) for name in ("benchmarks", "tests", "tests/claims/properties"))]

from breaks_of_claims import breaks  # noqa: E402
from planted_breaks import Break  # noqa: E402

from safety_harness.admission.claims import property_of  # noqa: E402
from safety_harness.base.compiled import source_hash  # noqa: E402
from safety_harness.scenario.model import Claim, Verdict  # noqa: E402
from safety_harness.trace.trace import Trace  # noqa: E402

RESULTS = ROOT / "docs" / "smallest-breaks.json"
LEAST = 1e-3  # of a unit: what is smaller is not told apart
PARTS = ("smallest_breaks", "breaks_of_claims", "planted_breaks", "own_oracles")


def violated(sentence: str, trace: Trace) -> bool:
    """Does the claim say so?"""
    claim = Claim(sentence=sentence, expected=Verdict.HOLDS)
    return property_of(claim, trace.scenario).evaluate(trace).verdict is Verdict.VIOLATED


def caught(one: Break, magnitude: float) -> tuple[bool, float]:
    """Is the run with a magnitude violated, by claim and oracle, and by how much by the oracle?

    The oracle is asked where the claim says so.  ValueError if it is alone, by more than ``one.known``.
    """
    trace = one.plant(magnitude)
    if not violated(one.sentence, trace):
        return False, 0.0
    excess = float(one.excess(trace))
    if excess < -one.known:
        raise ValueError(f"{one.sentence}: a false alarm by {-excess:g} at {magnitude:g} ({one.what})")
    return excess > 0.0, excess


def smallest(one: Break) -> tuple[float, float]:
    """The least magnitude that is caught, and the oracle's excess; ValueError if none is, or if all are."""
    low, high = one.sound, one.broken
    (sound, _), (broken, excess) = caught(one, low), caught(one, high)
    if sound or not broken:
        raise ValueError(f"{one.sentence}: {one.what} does not tell right from wrong")
    while abs(high - low) > (1.0 if one.whole else one.step):
        middle = float((low + high) // 2.0) if one.whole else 0.5 * (low + high)
        found, by = caught(one, middle)
        low, high, excess = (low, middle, by) if found else (middle, high, excess)
    return high, excess


def measured(one: Break) -> dict[str, Any]:
    """A row: claim, kind of break, the smallest that is caught, its magnitude and the runs' source."""
    magnitude, excess = smallest(one)
    shown = excess if one.shown is None else one.shown * magnitude
    return {
        "claim": one.sentence,
        "what": one.what,
        "smallest": rounded_up(max(shown, LEAST)),
        "unit": one.unit,
        "magnitude": magnitude,
        "source": source(),
    }


def rounded_up(value: float) -> float:
    """To two digits."""
    digit = 10.0 ** (floor(log10(value)) - 1)
    return float(f"{ceil(value / digit - 1e-9) * digit:.2g}")


def source() -> str:
    """Sixteen hex digits over the package and what these runs are made of."""
    own = (hashlib.sha256((ROOT / "benchmarks" / f"{part}.py").read_bytes()).hexdigest() for part in PARTS)
    return hashlib.sha256("".join([source_hash(), *own]).encode()).hexdigest()[:16]


def main() -> None:
    """Measure what this source has not measured yet."""
    found = json.loads(RESULTS.read_text("utf-8")) if RESULTS.exists() else []
    rows = {(row["claim"], row["what"]): row for row in found}
    for one in (every := breaks()):
        key, began = (one.sentence, one.what), time.monotonic()
        if rows.get(key, {}).get("source") != source():
            rows[key] = measured(one)
            print(f"{one.sentence}: {rows[key]['smallest']:g} {one.unit}, {time.monotonic() - began:.1f} s")
        kept = [rows[key] for key in ((each.sentence, each.what) for each in every) if key in rows]
        RESULTS.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
