"""Documents and names use the field's words (docs/reference/glossary.md), none of our private ones.

What a program prints and what a scenario file says stands in code, where anything may stand.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WRITTEN = {"docs/results/paper-numbers.md", "docs/results/networks.md"}  # by a program, from what it prints
PAGES = [
    page
    for pattern in ("*.md", "docs/**/*.md", "paper/*.md", "scenarios/recordings/*.md")
    for page in sorted(ROOT.glob(pattern))
    if page.name != "CHANGELOG.md" and str(page.relative_to(ROOT)) not in WRITTEN
]
PRIVATE = {  # what we said: what the field says
    r"to the test": "exercised",
    r"on trial": "mutation testing",
    r"kill table": "mutation score",
    r"giv(e|es|ing|en) way": "retreat",
    r"asked (where it is|elsewhere)": "called in-process, out of process",
    r"deaf to|not heard": "ignores",
    r"mishaps?": "run error",
    r"one story": "have the same structure",
    r"gravest|as grave as": "the worst claim decides",
    r"given that they can be tried": "conditioned on admissibility",
    r"numbers? that (are|is) none|(is|are) no number|is none to": "NaN or infinity; not a valid one",
    r"(the|this|these|other|every) rooms?": "package",
    r"(values?|points?|all|region|scale) alike": "uniform",
    r"a millionth of it": "truncation leaves at least 1e-6 of the mass",
    r"nothing is remembered": "stateless",
    r"the house": "the package",
    r"by lot": "at random",
}

BARE = {  # as the whole name of a function, a parameter or a variable
    *("about", "after", "apart", "asked", "asking", "before", "between", "beyond", "by", "carry_on", "down"),
    *("erring", "found", "from", "gravest", "gravity", "in", "look", "looker", "mishap", "near", "of", "off"),
    *(
        "one",
        "ones",
        "other",
        "others",
        "outright",
        "over",
        "room",
        "said",
        "says",
        "spoilt",
        "taken",
        "tell",
    ),
    *("tent", "told", "under", "up", "way", "ways", "what", "which", "whose", "within", "word", "words"),
    "wrong",
}
MOST_BARE_VARIABLES = 127  # most are fields of stored results, and old names that work for one release


def names_of(text: str) -> Iterator[tuple[str, str]]:
    """Yield (kind, name) for each function, parameter and assigned variable of a program."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield "function", node.name
        elif isinstance(node, ast.arg):
            yield "parameter", node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield "variable", node.id


def bare_names(text: str) -> list[tuple[str, str]]:
    """Return the names of a program that say nothing by themselves."""
    return [(kind, name) for kind, name in names_of(text) if name.strip("_").lower() in BARE]


def prose(text: str) -> str:
    """A page without its generated tables and its code, on one line."""
    for code in (r"<!-- table: .*?<!-- end -->", r"^```.*?^```$", r"`[^`\n]*`"):
        text = re.sub(code, " ", text, flags=re.DOTALL | re.MULTILINE)
    return " ".join(text.split())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_has_no_private_words(page: Path) -> None:
    text = prose(page.read_text())
    found = {
        found[0]: word for said, word in PRIVATE.items() for found in re.finditer(rf"\b{said}\b", text, re.I)
    }
    assert not found


def test_what_is_printed_may_be_quoted() -> None:
    page = "It says `on trial`.\n\n```\nalso on trial\n```\n<!-- table: a -->\n| gives way |\n<!-- end -->\n"
    assert prose(page) == "It says ."


def test_a_phrase_is_found_over_the_end_of_a_line() -> None:
    assert re.search("put to the test", prose("a claim that no run put\nto the test"))


def test_no_function_or_parameter_has_a_bare_name_and_few_variables_do() -> None:
    bare = [
        (kind, f"{path.relative_to(ROOT)}: {name}")
        for path in sorted((ROOT / "safety_harness").rglob("*.py"))
        for kind, name in bare_names(path.read_text(encoding="utf-8"))
    ]
    assert [name for kind, name in bare if kind != "variable"] == []
    assert Counter(kind for kind, _ in bare)["variable"] <= MOST_BARE_VARIABLES


def test_a_bare_name_is_seen_in_each_place() -> None:
    program = (
        "def told(of, *, whose=0):\n    _one = lambda what: what\n    return [word for word in _one(of)]\n"
    )
    seen = [("function", "told"), *(("parameter", name) for name in ("of", "what", "whose"))]
    assert sorted(bare_names(program)) == sorted([*seen, ("variable", "_one"), ("variable", "word")])
