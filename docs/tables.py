"""Write the tables of keys and claims into the pages, and the JSON Schema.  Run: python docs/tables.py."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from safety_harness.formulas.pages import markdown_of_signals
from safety_harness.properties.catalogue import CATALOGUE
from safety_harness.properties.pages import markdown_of_claims
from safety_harness.scenario.reference import markdown, markdown_of_moves
from safety_harness.scenario.reference_hands import MOVES
from safety_harness.scenario.reference_tables import every_table
from safety_harness.scenario.schema import scenario_schema

DOCS = Path(__file__).parent
SCHEMA = DOCS / "schema" / "scenario.schema.json"
_MARKED = re.compile(r"(<!-- table: (.*?) -->\n).*?(<!-- end -->\n)", re.DOTALL)


def with_tables(text: str) -> str:
    """A page with every marked table as it should be; KeyError for a table that there is not."""
    tables = {table.name: markdown(table) for table in every_table()}
    tables["moves"] = markdown_of_moves(MOVES)
    tables["claims"] = markdown_of_claims(CATALOGUE)
    tables["signals"] = markdown_of_signals()
    return _MARKED.sub(lambda found: found[1] + tables[found[2]] + found[3], text)


def schema_text() -> str:
    """The schema as it is published."""
    return json.dumps(scenario_schema(), indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    """Bring every page and the schema up to date; say which ones changed."""
    SCHEMA.parent.mkdir(exist_ok=True)
    new = {page: with_tables(page.read_text()) for page in sorted(DOCS.glob("*.md"))}
    new[SCHEMA] = schema_text()
    for path, text in new.items():
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
            sys.stdout.write(f"{path.relative_to(DOCS.parent)}\n")


if __name__ == "__main__":
    main()
