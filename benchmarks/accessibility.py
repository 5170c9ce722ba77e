"""Is every kind of page accessible?  axe-core on each sample page, its tab stops and its printed pages.

axe-core (MPL-2.0) is not part of this repository:

    npm install --prefix /tmp/axe axe-core
    python benchmarks/accessibility.py /tmp/axe/node_modules/axe-core/axe.min.js [PAGE]...

Each page is asked at two widths, light and dark, as it opens and with all that folds unfolded.  Exit code 1
if axe-core names a violation, or cannot decide what `contrast.js` does not decide either.
"""

from __future__ import annotations

import base64
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from browsing import show, started  # noqa: E402

from safety_harness.trace.provenance import provenance  # noqa: E402

TABLE = ROOT / "benchmarks" / "ACCESSIBILITY.md"
WIDTHS_PX, SCHEMES = (1280, 390), ("light", "dark")
UNFOLD = "document.querySelectorAll('details').forEach((one) => { one.open = true; })"
ASK = """const done = arguments[0];
axe.run(document, { resultTypes: ["violations", "incomplete"] }).then((found) => done(
  ["violations", "incomplete"].map((kind) => found[kind].flatMap((rule) => rule.nodes.map((node) => [
    rule.id, rule.help, node.target.join(" "), (node.any[0] ?? node.all[0] ?? node.none[0])?.message ?? ""
  ])))));"""
CONTRAST = (ROOT / "benchmarks" / "contrast.js").read_text(encoding="utf-8")
STOPS = """const all = "a[href], button, input, select, textarea, summary, [tabindex]";
return [...document.querySelectorAll(all)].filter((one) => one.tabIndex >= 0 && !one.disabled
  && one.checkVisibility({ visibilityProperty: true })).length"""


def asked(browser: Any, page: Path, axe: str) -> Iterator[tuple[str, list[str], str]]:
    """(violation or incomplete, what axe-core says of a node, under which conditions)."""
    for width_px in WIDTHS_PX:
        for scheme in SCHEMES:
            for folded in (True, False):
                show(browser, page.resolve().as_uri(), width=width_px, scheme=scheme)
                if not folded:
                    browser.execute_script(UNFOLD)
                browser.execute_script(axe)
                where = f"{width_px} px, {scheme}{'' if folded else ', unfolded'}"
                violations, incomplete = browser.execute_async_script(ASK)
                yield from (("violation", node, where) for node in violations)
                undecided = browser.execute_script(CONTRAST, incomplete)
                yield from (("incomplete", node, where) for node in undecided)


def printed_pages(browser: Any, page: Path) -> int:
    """As Chromium prints it."""
    show(browser, page.resolve().as_uri(), width=1280, media="print")
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True, "printBackground": True})
    return len(re.findall(rb"/Type\s*/Page\b(?!s)", base64.b64decode(printed["data"])))


def main() -> int:
    """Print what axe-core found; without PAGEs the table is written."""
    if len(sys.argv) < 2:
        print(__doc__)
        return 2
    axe = Path(sys.argv[1]).read_text(encoding="utf-8")
    pages = [Path(one) for one in sys.argv[2:]] or sorted((ROOT / "reports" / "sample").rglob("*.html"))
    rows, open_ones = [], 0
    with tempfile.TemporaryDirectory() as profile:
        browser = started(Path(profile))
        browser.set_script_timeout(300)
        for page in pages:
            found = list(asked(browser, page, axe))
            for (kind, rule, target, message), many in Counter(
                (kind, node[0], node[2], node[3]) for kind, node, _ in found
            ).items():
                print(f"{page.name}: {kind} {rule} at {target} ({many} times): {message}")
            kinds = Counter(kind for kind, _, _ in found)
            show(browser, page.resolve().as_uri(), width=1280)
            stops = browser.execute_script(STOPS)
            row = (page.stem, kinds["violation"], kinds["incomplete"], stops, printed_pages(browser, page))
            print(*row, flush=True)
            rows.append(row)
            open_ones += len(found)
        version = browser.execute_script(axe + "; return axe.version")
        browser.quit()
    if len(sys.argv) == 2:
        TABLE.write_text(table(rows, version))
    return 1 if open_ones else 0


def table(rows: list[tuple[str, int, int, int, int]], version: str) -> str:
    """As it is committed."""
    git = ["git", "describe", "--always", "--dirty", "--exclude", "*"]
    revision = subprocess.run(git, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    lines = [
        "# Accessibility of the pages",
        "",
        f"axe-core {version} on the pages of `reports/sample`, at {' and '.join(map(str, WIDTHS_PX))} px,",
        "light and dark, as they open and unfolded: nodes that it calls a violation, and nodes that it",
        "cannot decide (of those of contrast `contrast.js` decides by the colours: 4.5 to 1, for large",
        "letters 3 to 1).",
        "Tab stops as a page opens, at 1280 px; printed pages as Chromium prints it.",
        f"Revision {revision}, source {provenance('').source_hash}.",
        "Again: `make accessibility AXE=.../axe.min.js`.",
        "",
        "| page | violations | undecided | tab stops | printed pages |",
        "|---|---:|---:|---:|---:|",
        *(f"| {' | '.join(map(str, row))} |" for row in rows),
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
