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


def shares(name: str) -> bool:
    """Whether a file of tests has a fixture for all of them."""
    return any('scope="module"' in path.read_text() for path in TESTS.rglob(name))


def main(file: str, seconds: str = "600") -> None:
    """Read the times and write the list."""
    times: Counter[str] = Counter()
    weights: dict[str, float] = {}
    for case in ElementTree.parse(file).iter("testcase"):
        path = Path(*(case.get("classname") or "").split("."))
        if path.parts[:1] in (("tests",), ("paper",)):  # not the suites of examples
            name = f"{path.name}.py::{case.get('name', '').partition('[')[0]}"
            times[name] += float(case.get("time", 0.0))
            weights[name] = 0.5 if (PACKAGE / path.parts[1]).is_dir() else 1.0
    # What is asked of the site waits for it to be built, and is not in a run of the others.
    listed = (TESTS / "slow.txt").read_text().split()
    taken, slow = times.total(), {name for name in listed if name.startswith("test_site.py::")}
    for name in sorted(times, key=lambda one: -times[one] * weights[one]):
        if taken - sum(times[one] for one in slow) <= float(seconds):
            break
        of_file = {one for one in times if one.partition("::")[0] == name.partition("::")[0]}
        # What a module's tests share is made for the first of them: the others go with it.
        shared = times[name] > 0.5 * sum(times[one] for one in of_file) and shares(name.partition("::")[0])
        slow |= of_file if shared else {name}
    left = taken - sum(times[one] for one in slow)
    (TESTS / "slow.txt").write_text("\n".join(sorted(slow)) + "\n")
    print(f"{len(slow)} of {len(times)} functions are slow: {taken - left:.0f} of {taken:.0f} s")


if __name__ == "__main__":
    main(*sys.argv[1:])
