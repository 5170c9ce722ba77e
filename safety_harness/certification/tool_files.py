"""What is known of the harness itself, from files: its trial on seeded faults, its independent oracles."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from safety_harness.certification.tools import Fault, Oracle, SelfTest
from safety_harness.compiled import source_hash
from safety_harness.exceptions import InputError, Place
from safety_harness.scenario.files import refuse_no_file

FORMAT = "safety-harness selftest 1"
LARGEST_BYTES = 64 * 2**20
MOST = 1e100  # that a disagreement can be
ON_TRIAL = ("caught", "survives")  # others are harmless, or do not apply to the system


def read_selftest(path: Path) -> SelfTest:
    """InputError, naming the field, for what is no such file."""
    found = _json(path, "a selftest.json")
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise _error(path, "format", repr(FORMAT), repr(found)[:60])
    about, faults = _part(path, found, "about", dict), _part(path, found, "faults", list)
    known = [fault for fault in faults if isinstance(fault, dict)]
    source = str(about.get("source_hash", ""))
    return SelfTest(
        profile=str(about.get("profile", "unknown")),
        faults=tuple(
            _fault(path, k, fault) for k, fault in enumerate(known) if fault.get("state") in ON_TRIAL
        ),
        false_alarms=tuple(str(fault.get("fault")) for fault in known if fault.get("state") == "false alarm"),
        source_hash=source,
        present=source == source_hash(),
    )


def read_oracles(path: Path) -> tuple[Oracle, ...]:
    """The table that ``make oracles`` writes; InputError for what is none."""
    found = _json(path, "a table of oracles")
    if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
        raise _error(path, "", "a list of objects", repr(found)[:60])
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


def _json(path: Path, expected: str) -> Any:
    refuse_no_file(path, expected, InputError)
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise _error(path, "", expected, error.strerror or str(error)) from error
    if len(data) > LARGEST_BYTES:
        raise _error(path, "", f"at most {LARGEST_BYTES} bytes", "more")
    try:
        return json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise _error(path, "", "JSON", str(error)) from error


def _fault(path: Path, number: int, fault: dict[str, Any]) -> Fault:
    def text(name: str) -> str:
        value = fault.get(name)
        if value is not None and not isinstance(value, str):
            raise _error(path, f"faults[{number}].{name}", "a text", repr(value)[:60])
        return value or ""

    caught = text("state") == "caught"
    return Fault(
        name=text("fault"),
        part=text("part"),
        hazard=text("hazard"),
        caught_by=(text("caught_by") or "a claim that is not named") if caught else "",
        smallest=text("slightest_caught"),
        known_limit=text("known_limit"),
    )


def _part(path: Path, found: dict[str, Any], name: str, kind: type) -> Any:
    value = found.get(name)
    if not isinstance(value, kind):
        raise _error(path, name, "an object" if kind is dict else "a list", repr(value)[:60])
    return value


def _error(path: Path, field: str, expected: str, got: str) -> InputError:
    return InputError(place=Place(file=path, field=field or None), expected=expected, got=got)
