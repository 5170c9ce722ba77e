"""Draw the packages and their imports for docs/explanation/architecture.md; ``docs/tables.py`` calls it."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "safety_harness"
CORE = {
    "base": "errors, settings, seeds, geometry",
    "scenario": "the input of a run, as text and as data",
    "trace": "the record of a run",
    "seams": "interfaces for code of your own",
    "cell": "robot, perception, controller, worlds",
    "space": "distributions in place of values",
    "claims": "requirements with signed margins",
    "admission": "check, run and judge a scenario",
    "search": "find violations",
    "report": "results and files of runs",
    "testing": "pytest and Hypothesis",
    "cli": "parse, call, print",
}
WINGS = {  # the left edge of each, its row, and what it is for
    "worlds": (20, 7, "more simulators"),
    "gym": (640, 8, "learning environments"),
    "attribution": (330, 12, "whose fault?"),
    "pages": (330, 13, "HTML and pictures"),
    "arms": (40, 14, "fit and show arms"),
    "lab": (330, 15, "train, score, prove"),
    "field": (620, 15, "logs of real cells"),
    "assurance": (330, 16, "estimate, certify"),
    "selftest": (330, 17, "mutation testing"),
}
LEFT = dict.fromkeys(CORE, 265) | {name: left for name, (left, _, _) in WINGS.items()}
WIDTH = dict.fromkeys(CORE, 350) | dict.fromkeys(WINGS, 220)
ROW = {name: row for row, name in enumerate(CORE)} | {name: row for name, (_, row, _) in WINGS.items()}
WORDS = CORE | {name: words for name, (_, _, words) in WINGS.items()}
HEIGHT = 34
HEAD = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 880 1020" font-family="sans-serif">
<rect width="880" height="1020" rx="8" fill="#ffffff"/>
<defs><marker id="a" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto">
<path d="M0 0 10 5 0 10z" fill="#37474f"/></marker></defs>
<g font-size="14" font-weight="bold"><text x="20" y="38">core</text><text x="20" y="640">wings</text></g>
<g stroke="#37474f" stroke-width="1.6" fill="none" marker-end="url(#a)">"""


def package_of(module: str) -> str:
    """Return the package of the core, or the wing, of a module such as ``extensions.lab.proof``."""
    return module.removeprefix("extensions.").partition(".")[0]


def imports() -> dict[str, set[str]]:
    """Return the packages that the files of each package import."""
    found: dict[str, set[str]] = {name: set() for name in WORDS}
    for file in PACKAGE.rglob("*/*.py"):
        importer = package_of(".".join(file.relative_to(PACKAGE).with_suffix("").parts))
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("safety_harness."):
                found[importer] |= {package_of(str(node.module).removeprefix("safety_harness."))} - {importer}
    return found


def path(importer: str, imported: str) -> str:
    """Return the path of an arrow."""
    middle, goal = (LEFT[name] + WIDTH[name] // 2 for name in (importer, imported))
    top, end, right = 20 + 54 * ROW[importer], 20 + 54 * ROW[imported], LEFT[imported] + WIDTH[imported] + 1
    if middle == goal and ROW[importer] == ROW[imported] + 1:
        return f"M{middle} {top}V{end + HEIGHT + 1}"
    if middle == goal:
        return f"M{right} {top + 8}H{right + 15}V{end + HEIGHT // 2}H{right}"
    if imported in CORE:
        return f"M{middle} {top}V{end + 20}H{right if middle > goal else LEFT[imported] - 1}"
    return f"M{LEFT[importer] + WIDTH[importer]} {top + HEIGHT // 2}H{goal}V{end + HEIGHT + 1}"


def picture() -> str:
    """Return the SVG.  An arrow is left out if other arrows lead to the same package."""
    graph = imports()
    below = cache(lambda name: graph[name].union(*map(below, graph[name])))
    floors = cache(lambda name: 1 + max(map(floors, graph[name]), default=0))
    every = [(name, one) for name in graph for one in sorted(graph[name])]
    drawn = [(name, one) for name, one in every if not any(one in below(other) for other in graph[name])]
    lines = [*(f'<path d="{path(*arrow)}"/>' for arrow in drawn), "</g>", '<g font-size="12">']
    for name, words in WORDS.items():
        x, y, fill = LEFT[name], 20 + 54 * ROW[name], "#e3f2fd" if name in CORE else "#fff3e0"
        box = f'x="{x}" y="{y}" width="{WIDTH[name]}" height="{HEIGHT}" rx="6" fill="{fill}" stroke="#37474f"'
        text = f'<tspan font-weight="bold" font-size="14">{name}</tspan><tspan dx="9">{words}</tspan>'
        lines.append(f'<rect {box}/><text x="{x + 10}" y="{y + 22}">{text}</text>')
    counts = f"{len(graph)} packages; {len(every)} pairs with imports, {len(drawn)} of them drawn"
    legend = f'<text x="20" y="1004">{counts}; longest chain: {max(map(floors, graph))} packages</text></g>'
    return "\n".join([HEAD, *lines, legend, "</svg>"]) + "\n"
