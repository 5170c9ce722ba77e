"""Write docs/results/paper-numbers.md and the small sample beside it from the JSON of one run or several.

Run: python paper/results_page.py reports/reproduction/reproduction.json [SENSITIVITY.json]
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1] / "docs"
PAGE, SAMPLE = DOCS / "results" / "paper-numbers.md", DOCS / "reproduction-results.json"
HEAD = """\
<!-- reader: research; written by: paper/results_page.py; question: Which numbers came out? -->

# What came out of the reproduction

`python paper/results_page.py` writes this page from the JSON files of these runs:

{runs}

The page [The paper, reproduced](paper.md) describes the measurements and the rules of the verdicts. The
command writes a page that also has the plots. The numbers are stored in
[reproduction-results.json](../reproduction-results.json).

| part | verdict | why |
|---|---|---|
"""
RUN = (
    "- {names}: scale {scale}, seed {seed}, {date}, safety-harness {package_version}, "
    "source hash `{source_hash}`"
)


def row(*cells: str) -> str:
    """One line of a table; a bar inside a cell would end it."""
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def lines(runs: list[dict[str, Any]]) -> Iterator[str]:
    """The whole page."""
    results = [one for found in runs for one in found["results"]]
    yield HEAD.format(runs="\n".join(map(run_of, runs))).rstrip("\n")
    for one in results:
        yield row(f"[{one['source']}](#{one['name']}): {one['title']}", f"**{one['word']}**", one["why"])
    for found in runs:
        for name, why in found["about"]["missing"]:
            yield row(name, "*missing*", why)
    for one in results:
        yield from part(one)


def run_of(found: dict[str, Any]) -> str:
    """Which run it was, for people."""
    about = found["about"]
    names = ", ".join(one["name"] for one in found["results"])
    return RUN.format(names=names, **about, date=about["generated_at"][:10])


def part(one: dict[str, Any]) -> Iterator[str]:
    """One part: claims, figures, tables, notes."""
    yield f"\n## {one['name']}\n\n**{one['source']}: {one['title']}.** The paper: {one['paper_says']}\n"
    yield f"**{one['word']}.** {one['why']}"
    if one["claims"]:
        yield "\n| claim | | evidence |\n|---|---|---|"
        for claim in one["claims"]:
            yield row(claim["sentence"], claim["state"], claim["evidence"])
    if one["comparisons"]:
        yield "\n| figure | the paper | ours | agree? |\n|---|---|---|---|"
        for figure in one["comparisons"]:
            yield row(figure["label"], figure["paper_words"], figure["ours_words"], figure["agrees_words"])
    for table in one["tables"]:
        yield f"\n{table['caption']}\n\n{row(*table['head'])}\n|{'---|' * len(table['head'])}"
        for cells in table["rows"]:
            yield row(*cells)
    if one["notes"]:
        yield ""
        yield from (f"- {note}" for note in one["notes"])


def sample(found: dict[str, Any]) -> dict[str, Any]:
    """All but the plots' points and the keys."""
    about = {key: value for key, value in found["about"].items() if key not in ("keys", "command")}
    results = [{key: value for key, value in one.items() if key != "plots"} for one in found["results"]]
    return found | {"about": about, "results": results}


def main() -> None:
    """Read, write both."""
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    runs = [json.loads(Path(name).read_text("utf-8")) for name in sys.argv[1:]]
    PAGE.write_text("\n".join(lines(runs)) + "\n", "utf-8")
    samples = [sample(found) for found in runs]
    SAMPLE.write_text(json.dumps(samples, indent=1, ensure_ascii=False) + "\n", "utf-8")


if __name__ == "__main__":
    main()
