"""The evidence as JSON and back, and the JSON schema of it: all three read off the types."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec

from safety_harness.certification.evidence import FORMAT, Evidence
from safety_harness.scenario.typed_json import of_format, plain, read_json, typed


def as_text(evidence: Evidence) -> str:
    """The whole report as JSON; ValueError for a number that is not finite."""
    return json.dumps(plain(evidence), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def read_evidence(path: Path) -> Evidence:
    """What ``as_text`` wrote; InputError with the place of what is not as it should be."""
    return typed(of_format(read_json(path, "an evidence report"), FORMAT, path), Evidence, path)


def schema() -> dict[str, Any]:
    """The published schema of the JSON (draft 2020-12)."""
    found = msgspec.json.schema(Evidence)
    for kind in found["$defs"].values():
        if kind.get("type") == "object":  # with all of its fields and no others
            kind |= {"required": list(kind["properties"]), "additionalProperties": False}
            for part in kind["properties"].values():
                part.pop("default", None)
    found["$defs"]["Evidence"]["properties"]["format"] = {"const": FORMAT}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": FORMAT, **found}
