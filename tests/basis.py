"""Does an output say what its verdicts rest on?"""

from __future__ import annotations

import re

from safety_harness.claims.properties.tally import UNWATCHED

EXERCISED = re.compile(r"claims? exercised in (\d+ (of \d+ )?to )?\d+ of \d+ runs")


def rests_on(text: str, world: str, *, unwatched: tuple[str, ...] = UNWATCHED) -> bool:
    """Are the three facts in one sentence?"""
    names = [one.partition(":")[0] for one in unwatched]
    return any(
        bool(EXERCISED.search(said))
        and said.startswith(f" in {world};")
        and all(name in said for name in names)
        for said in page_text(text).split("Basis:")[1:]
    )


def page_text(page: str) -> str:
    return " ".join(re.sub(r"&#39;|\\u2019", "'", page).split())
