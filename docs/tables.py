"""Write the tables of keys and claims into the pages, and the JSON Schema.  Run: python docs/tables.py."""

from __future__ import annotations

import ast
import json
import re
import sys
from collections import Counter
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import click
import typer
from architecture_picture import picture

from safety_harness.base import extension_points
from safety_harness.base.exceptions import Place
from safety_harness.claims.formulas.signals import SIGNALS
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.claims.properties.entry import entry_fields
from safety_harness.cli.main import ELSEWHERE, TASK_OF, app
from safety_harness.extensions.assurance.campaign.plan_keys import PLAN, TABLES, TITLE
from safety_harness.extensions.assurance.certification.evidence import schema as evidence_schema
from safety_harness.extensions.assurance.certification.standards import STANDARDS, standards_of
from safety_harness.extensions.selftest.outcome import markdown as table_of
from safety_harness.scenario import units
from safety_harness.scenario.codec import Below, Key, KeyTable, QuantityValue
from safety_harness.scenario.codec import table_of as table_of_keys
from safety_harness.scenario.faults import EVERY_FAULT, OWN_KEYS, Timed
from safety_harness.scenario.moves import MOVES
from safety_harness.scenario.reference_tables import every_table
from safety_harness.scenario.schema import scenario_schema, table_schema

DOCS = Path(__file__).parent
SCHEMA = DOCS / "schema" / "scenario.schema.json"
PICTURE = DOCS / "assets" / "architecture.svg"
EVIDENCE = DOCS / "schema" / "evidence.schema.json"
PLANS = DOCS / "schema" / "plan.schema.json"
KILLS = DOCS / "selftest-results.json"
ORACLES = DOCS.parent / "plans" / "oracles.json"
MUTANTS = DOCS / "mutants.json"
BREAKS = DOCS / "smallest-breaks.json"
KILL_HEAD = ("part", "fault", "slightest caught", "by", "in", "after episodes", "survives")
KILL_FIELDS = ("part", "fault", "slightest_caught", "caught_by", "scenario", "after_episodes", "survives")
ROOT = Path(extension_points.__file__).parents[1] / "__init__.py"
_MARKED = re.compile(r"(<!-- table: (.*?) -->\n).*?(<!-- end -->\n)", re.DOTALL)


def with_tables(text: str, page: Path) -> str:
    """A page with every marked table as it should be; KeyError for a table that there is not.

    A cell names a page from docs/; its link leads there from the folder of this page.
    """
    up = "../" * (len(page.relative_to(DOCS).parts) - 1)
    tables = {table.name: markdown(table) for table in (*every_table(), *TABLES)}
    tables["moves"] = markdown_of_moves(MOVES)
    tables["units"] = markdown_of_units()
    tables["faults"] = markdown_of_faults()
    tables["the time of a fault"] = markdown(table_of_keys(Timed, "the time of a fault"))
    tables["claims"] = markdown_of_claims()
    tables["standards"] = markdown_of_standards()
    tables["extension points"] = markdown_of_extension_points()
    tables["signals"] = markdown_of_signals()
    tables["oracles"] = markdown_of_oracles()
    tables["kills"], tables["harmless"] = markdown_of_kills()
    tables["mutants"], tables["mutants that survived"] = markdown_of_mutants()
    tables["exit codes"] = markdown_of_exit_codes()
    tables["common options"], tables["commands"] = markdown_of_commands()
    tables = {name: re.sub(r"\]\((?=[\w/-]+\.md)", f"]({up}", table) for name, table in tables.items()}
    return _MARKED.sub(lambda found: found[1] + tables[found[2]] + found[3], text)


def markdown(table: KeyTable) -> str:
    """The table as a page shows it; keys of an inner mapping follow the key that they stand below."""
    rows = ["| key | value | default | meaning |", "|---|---|---|---|"]
    for key in table.keys:
        rows.append(f"| `{key.name}` | {key.kind} | {key.default} | {key.meaning} |")
        for inner in (
            key.value.tables if isinstance(key.value, Below) and not key.value.tables[0].path else ()
        ):
            rows += [
                f"| `{key.name}`: `{one.name}` | {one.kind} | {one.default} | {one.meaning} |"
                for one in inner.keys
            ]
    return _joined(rows)


def markdown_of_moves(moves: tuple[KeyTable, ...]) -> str:
    """The moves as a page shows them, one row for each with its further keys."""
    rows = ["| move | further keys | meaning |", "|---|---|---|"]
    for table in moves:
        named, *further = (f"`{key.name}` ({_kind(key)})" for key in table.keys)
        rows.append(f"| {named} | {', '.join(further)} | {table.keys[0].meaning} |")
    return _joined(rows)


def markdown_of_units() -> str:
    """Return every dimension with its units, an example and the bounds of a setting."""
    dimensions = [one for one in vars(units).values() if isinstance(one, units.Dimension)]
    rows = ["| dimension | units | example | a setting of it |", "|---|---|---|---|"]
    for one in dimensions:
        allowed = ", ".join([*one.units, *["or no unit" if one.units else "no unit"][: one.bare]])
        bounds = f"{_shortest(one.least, one)} to {_shortest(one.most, one)}"
        rows.append(f"| {one.name} | {allowed} | {one.example.partition(' or ')[0]} | {bounds} |")
    return _joined(rows)


def _shortest(value: float, dimension: units.Dimension) -> str:
    """Return the shortest text of a value in SI that means exactly this value."""
    texts = [f"{value:.9f}".rstrip("0").rstrip(".")] if not dimension.units else []
    for unit in dimension.units:
        number = f"{value / units.parse_quantity(f'1 {unit}', dimension, Place()):.9f}".rstrip("0").rstrip(
            "."
        )
        texts.append(f"{number} {unit}")
    exact = [one for one in texts if units.parse_quantity(one, dimension, Place()) == value]
    return min(exact, key=len)


def markdown_of_faults() -> str:
    """Return every fault with its further keys and the docstring of its record."""
    rows = ["| fault | further keys | meaning |", "|---|---|---|"]
    for kind in EVERY_FAULT:
        own = OWN_KEYS[kind]
        further = ", ".join(f"`{key.name}` ({key.kind})" for key in own.keys)
        told = " ".join(kind.__doc__.split())
        for key in own.keys:
            told = told.replace(f"``{key.attribute}``", f"`{key.name}`")
        rows.append(f"| `{own.told_by}: {own.name}` | {further} | {told.removesuffix('.')} |")
    return _joined(rows)


def _joined(rows: list[str]) -> str:
    return "\n".join(rows).replace("|  |", "| |") + "\n"


def _kind(key: Key) -> str:
    return key.value.dimension.name if isinstance(key.value, QuantityValue) else key.value.kind


def names_of_wings() -> dict[str, tuple[str, ...]]:
    """By module the names that wings give to the root of the package: the ``__all__`` of a file of a wing."""
    found: dict[str, tuple[str, ...]] = {}
    for file in sorted((ROOT.parent / "extensions").glob("*/*.py")):
        for node in ast.parse(file.read_text("utf-8")).body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
                module = ".".join(file.relative_to(ROOT.parent).with_suffix("").parts)
                found[module] = tuple(sorted(ast.literal_eval(node.value)))
    return found


def with_names_of_wings(text: str) -> str:
    """The package's ``__init__.py`` with the names that wings give to it."""
    table = "".join(
        f'    "{home}": ({", ".join(json.dumps(one) for one in own)}{"," * (len(own) == 1)}),\n'
        for home, own in names_of_wings().items()
    )
    marked = re.compile(r"( *# docs/tables\.py writes these lines\.\n).*?( *# end\n)", re.DOTALL)
    return marked.sub(lambda found: found[1] + table + found[2], text)


def smallest_breaks() -> dict[str, str]:
    """By sentence the smallest break of each kind caught, as ``benchmarks/smallest_breaks.py`` found."""
    found: dict[str, str] = {}
    for one in json.loads(BREAKS.read_text("utf-8")):
        said = f"{one['smallest']:g} {one['unit']} ({one['what']})"
        found[one["claim"]] = "; ".join([*filter(None, [found.get(one["claim"])]), said])
    return found


def markdown_of_standards() -> str:
    """What of each document a report speaks to, as ``standards.yaml`` has it."""
    rows = [
        (one.name, asked.asks, asked.here or "**not covered**", asked.means)
        for one in STANDARDS.standards
        for asked in one.requirements
    ]
    head = ("document", "asks", "part of the report", "what it says, or what would cover it")
    documents = [(f"{one.name}, {one.about}", one.status, one.source) for one in STANDARDS.standards]
    return (
        f"Last looked up in {STANDARDS.checked}.\n\n"
        + "\n".join(table_of(("document", "status", "known from"), documents))
        + "\n\n"
        + "\n".join(table_of(head, rows))
        + "\n"
    )


def markdown_of_claims() -> str:
    """Return a table of all sentences, then each with everything that its entry and the standards say."""
    breaks = smallest_breaks()
    rows = ["| sentence | margin in | exercised when | smallest break caught |", "|---|---|---|---|"]
    sections = []
    for entry in CATALOGUE:
        cells = (f"`{entry.example}`", entry.unit.symbol or "a number", entry.exercised)
        rows.append(f"| {' | '.join((*cells, breaks.get(entry.example, 'not measured')))} |")
        lines = [f"- *{name}*: {text}" for name, text in chain(entry_fields(entry), standards_of(entry))]
        sections.append("\n".join([f"### {entry.example}", "", *lines]))
    return "\n".join(rows) + "\n\n" + "\n\n".join(sections) + "\n"


def markdown_of_signals() -> str:
    """Return a row for each signal: words, Python name, units, meaning, and the knowledge between ticks."""
    rows = ["| words | in Python | units | what it is | between ticks |", "|---|---|---|---|---|"]
    for signal in SIGNALS:
        units = "true or false"
        if signal.dimension:
            units = ", ".join(signal.dimension.units) or "a plain number"
        name = f"`{signal.words}` | `{signal.words.lower().replace(' ', '_')}()`"
        rows.append(f"| {name} | {units} | {signal.meaning} | {signal.between.value} |")
    return "\n".join(rows) + "\n"


def markdown_of_extension_points() -> str:
    """Return a row for each group of entry points, as the docstrings of ``ExtensionPoint`` have it."""
    tree = ast.parse(Path(extension_points.__file__).read_text("utf-8"))
    (group,) = (one for one in tree.body if isinstance(one, ast.ClassDef) and one.name == "ExtensionPoint")
    texts = [one.value.value for one in group.body if isinstance(one, ast.Expr | ast.Assign)]
    rows = []
    for name, text in zip(texts[1::2], texts[2::2], strict=True):
        kind, _, use = " ".join(text.split()).removeprefix("``").partition("``: ")
        rows.append((f"`{name}`", f"`{kind}`", use.replace("``", "`")))
    return "\n".join(table_of(("group", "type of a part", "use"), rows)) + "\n"


def every_command(group: Any, *before: str) -> Iterator[tuple[str, Any]]:
    """Yield the name and the command of each command of this distribution, in the order of the help."""
    context = click.Context(group)
    if "plan" in group.commands:  # of certify, which its own help leaves out
        yield " ".join(before), group.commands["plan"]
    for name in group.list_commands(context):
        if not before and (name not in TASK_OF or name in ELSEWHERE):
            continue
        found = group.get_command(context, name)
        if hasattr(found, "list_commands"):
            yield from every_command(found, *before, name)
        else:
            yield " ".join((*before, name)), found


def markdown_of_exit_codes() -> str:
    """Return a row per command that can end with 1, from its help."""
    rows = []
    for name, found in every_command(typer.main.get_command(app)):
        text = " ".join((found.help or "").split())
        parts = re.findall(r"Exit code (\d+)(?: too)?: (.*?)(?= Exit code |$)", text)
        codes = {
            which: "; ".join(part.rstrip(".") for code, part in parts if code == which) for which in "012"
        }
        if codes["1"]:
            rows.append((f"`{name}`", *codes.values()))
    return "\n".join(table_of(("command", "0", "1", "2"), rows)).replace("|  |", "| |") + "\n"


def markdown_of_commands() -> tuple[str, str]:
    """Return the table of options that three commands or more share, and a section per command."""
    found = list(every_command(typer.main.get_command(app)))
    uses = Counter(_option(one) for _, command in found for one in command.params)
    common = {option for option, count in uses.items() if count > 2}
    sections = []
    for name, command in found:
        options = [_option(one) for one in command.params if not one.hidden]
        rows = [option for option in options if option not in common]
        shared = ", ".join(option[0] for option in options if option in common)
        purpose = (command.help or "").partition("\n\n")[0]
        section = [f"### {name}", "", " ".join(purpose.split()), ""]
        section += [*table_of(("option", "meaning"), rows), ""] if rows else []
        sections.append("\n".join([*section, f"Common: {shared}."]))
    return "\n".join(table_of(("option", "meaning"), sorted(common))) + "\n", "\n\n".join(sections) + "\n"


def _option(one: Any) -> tuple[str, str]:
    """Return how a command line names an option or an argument, and its help."""
    name = ", ".join(f"`{word}`" for word in (*one.opts, *one.secondary_opts) if word.startswith("-"))
    return name or f"`{one.metavar or one.name.upper()}`", " ".join(
        (getattr(one, "help", None) or "").split()
    )


def markdown_of_kills() -> tuple[str, str]:
    """What the last self-test came to, as ``selftest-results.json`` has it."""
    found = json.loads(KILLS.read_text("utf-8"))["faults"]
    faults = [one for one in found if not one["harmless"]]
    rows = [[_cell(one[name]) for name in KILL_FIELDS] for one in faults]
    changes = [
        [one["fault"], one["harmless"], str(one["rungs"][0]["episodes"])] for one in found if one["harmless"]
    ]
    return (
        "\n".join(table_of(KILL_HEAD, rows)) + "\n",
        "\n".join(table_of(("change", "why it cannot matter", "episodes without an alarm"), changes)) + "\n",
    )


def markdown_of_oracles() -> str:
    """The largest disagreements, as ``make oracles`` found them."""
    found = json.loads(ORACLES.read_text("utf-8"))
    rows = [
        [one["oracle"], one["what"], f"{one['largest']:.1g} {one['unit']}".rstrip(), f"{one['numbers']:,}"]
        for one in found
    ]
    return "\n".join(table_of(("oracle", "compared", "largest disagreement", "numbers"), rows)) + "\n"


def markdown_of_mutants() -> tuple[str, str]:
    """What the last run of ``make mutants`` came to by file, and what became of those that survived at first.

    A note begins with what became of it: gap closed, equivalent, superfluous code, open.
    """
    found = [
        one for one in json.loads(MUTANTS.read_text("utf-8"))["mutants"] if one["outcome"] != "stillborn"
    ]
    files = sorted({one["mutant"]["file"] for one in found})
    kinds = ("noticed", "gap closed", "equivalent", "superfluous code", "open")
    rows = []
    for file in [*files, ""]:
        mine = [one for one in found if file in ("", one["mutant"]["file"])]
        became = [one.get("note", "").partition(":")[0] or "noticed" for one in mine]
        counts = [became.count(kind) for kind in kinds]
        if sum(counts) != len(mine):
            raise KeyError(f"{file or 'all files'}: a note begins with none of {', '.join(kinds)}")
        rows.append(
            [f"`{file}`" if file else "all", str(len(mine)), *(str(count or "-") for count in counts)]
        )
    noted = [one for one in found if one.get("note")]
    stories = [
        [
            f"`{one['mutant']['file']}`:{one['mutant']['line']}",
            _code(one["mutant"]["before"]) + " becomes " + _code(one["mutant"]["after"]),
            one["note"],
        ]
        for one in noted
    ]
    return (
        "\n".join(table_of(("file", "mutants", *kinds), rows)) + "\n",
        "\n".join(table_of(("where", "change", "what became of it"), stories)) + "\n",
    )


def _code(text: str) -> str:
    return "`" + " ".join(text.split()) + "`"


def _cell(value: object) -> str:
    return "-" if value is None else str(value)


def schema_text() -> str:
    """The schema as it is published."""
    return json.dumps(scenario_schema(), indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    """Bring every page and the schema up to date; say which ones changed."""
    SCHEMA.parent.mkdir(exist_ok=True)
    new = {page: with_tables(page.read_text(), page) for page in sorted(DOCS.rglob("*.md"))}
    new[PICTURE] = picture()
    new[SCHEMA] = schema_text()
    new[PLANS] = json.dumps(table_schema(PLAN, TITLE), indent=1, ensure_ascii=False) + "\n"
    new[EVIDENCE] = json.dumps(evidence_schema(), indent=1) + "\n"
    new[ROOT] = with_names_of_wings(ROOT.read_text("utf-8"))
    for path, text in new.items():
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
            sys.stdout.write(f"{path.relative_to(DOCS.parent)}\n")


if __name__ == "__main__":
    main()
