"""What is known of the harness itself, from files: its trial on seeded faults, its independent oracles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from safety_harness.certification.json_file import part, read_json, read_object
from safety_harness.certification.tools import CaughtFault, Oracle, SelfTest
from safety_harness.compiled import source_hash
from safety_harness.exceptions import InputError, Place

FORMAT = "safety-harness selftest 1"
MOST = 1e100  # that a disagreement can be
ON_TRIAL = ("caught", "survives", "a stated limit")
STATES = (*ON_TRIAL, "does not apply", "quiet", "false alarm", "true alarm")  # three of harmless ones


def read_selftest(path: Path) -> SelfTest:
    """InputError, naming the field, for what is no such file, or for one of a trial without any fault."""
    found = read_object(path, FORMAT, words="a selftest.json")
    about = part(path, found, "about", dict)
    tried = part(path, found, "faults", list)
    for k, one in enumerate(tried):
        if not isinstance(one, dict) or one.get("state") not in STATES:
            raise _error(
                path, f"faults[{k}]", f"a fault whose state is one of {', '.join(STATES)}", repr(one)
            )
    faults = tuple(_fault(path, k, one) for k, one in enumerate(tried) if one["state"] in ON_TRIAL)
    if not faults:
        raise _error(path, "faults", "at least one fault that was on trial", "none")
    source = part(path, about, "source_hash", str, "about.")
    planned = part(path, about, "planned", int, "about.")
    interrupted = part(path, about, "interrupted", bool, "about.") or len(tried) < planned
    return SelfTest(
        profile=part(path, about, "profile", str, "about."),
        faults=faults,
        false_alarms=tuple(str(one.get("fault")) for one in tried if one["state"] == "false alarm"),
        source_hash=source,
        present=source == source_hash(),
        whole=not interrupted and "--fault" not in part(path, about, "command", str, "about.").split(),
    )


def read_oracles(path: Path) -> tuple[Oracle, ...]:
    """The table that ``make oracles`` writes; InputError for what is none."""
    found = read_json(path, "a table of oracles")
    if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
        raise _error(path, "", "a list of objects", f"another {type(found).__name__}")
    return tuple(_oracle(path, k, one) for k, one in enumerate(found))


def _oracle(path: Path, place: int, one: dict[str, Any]) -> Oracle:
    largest: Any = one.get("largest")
    texts = [one.get(name) for name in ("what", "oracle", "unit")]
    number = isinstance(largest, int | float) and not isinstance(largest, bool)
    if not number or not -MOST < largest < MOST:  # of a NaN it is false
        raise _error(path, f"[{place}].largest", "a number", repr(largest)[:60])
    if not all(isinstance(text, str) for text in texts):
        raise _error(path, f"[{place}]", "what, oracle and unit as texts", repr(texts)[:60])
    what, oracle, unit = map(str, texts)
    return Oracle(part=what, against=oracle, largest=f"{float(largest):.2g} {unit}")


def _fault(path: Path, number: int, fault: dict[str, Any]) -> CaughtFault:
    def text(name: str) -> str:
        value = fault.get(name)
        if value is not None and not isinstance(value, str):
            raise _error(path, f"faults[{number}].{name}", "a text", repr(value)[:60])
        return value or ""

    caught = text("state") == "caught"
    return CaughtFault(
        name=text("fault"),
        part=text("part"),
        hazard=text("hazard"),
        caught_by=(text("caught_by") or "a claim that is not named") if caught else "",
        smallest=text("slightest_caught"),
        known_limit=text("limit"),
    )


def _error(path: Path, field: str, expected: str, got: str) -> InputError:
    return InputError(place=Place(file=path, field=field or None), expected=expected, got=got)
