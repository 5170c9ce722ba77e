#!/usr/bin/env python3
"""Write tests/slow.txt: what "make test" leaves to "make slow", from the times of a whole run.

    python -m pytest -n 2 --dist worksteal --assert=plain --junitxml reports/tests.xml
    .ci/slow.py reports/tests.xml [SECONDS]

Functions go to the list, those with the longest time over all their parameters first, until what is left
takes SECONDS (600: five minutes of two processors).  Of the core twice as long counts as long.  Says how many
they are.
"""

import sys
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

TESTS = Path(__file__).parents[1] / "tests"
PACKAGE = TESTS.parent / "safety_harness"


def main(file: str, seconds: str = "600") -> None:
    """Read the times and write the list."""
    times: Counter[str] = Counter()
    weights: dict[str, float] = {}
    for case in ElementTree.parse(file).iter("testcase"):
        path = Path(*(case.get("classname") or "").split("."))
        if path.name:
            name = f"{path.name}.py::{case.get('name', '').partition('[')[0]}"
            times[name] += float(case.get("time", 0.0))
            weights[name] = 0.5 if (PACKAGE / path.parts[1]).is_dir() else 1.0
    left, slow = times.total(), []
    for name in sorted(times, key=lambda one: -times[one] * weights[one]):
        if left <= float(seconds):
            break
        slow.append(name)
        left -= times[name]
    (TESTS / "slow.txt").write_text("\n".join(sorted(slow)) + "\n")
    taken = times.total()
    print(f"{len(slow)} of {len(times)} functions are slow: {taken - left:.0f} of {taken:.0f} s")


if __name__ == "__main__":
    main(*sys.argv[1:])
