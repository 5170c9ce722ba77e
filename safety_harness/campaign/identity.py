"""What the results of a plan depend on, by name and hash, so that a change can be named."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module

from safety_harness.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.campaign.files import PlanFile, references_in
from safety_harness.space.space import ScenarioSpace
from safety_harness.trace.provenance import provenance


@dataclass(frozen=True)
class Identity:
    """What (a file, a network, a library) and its hash or version."""

    parts: tuple[tuple[str, str], ...]

    @property
    def sha256(self) -> str:
        """Stands for all parts."""
        return hashlib.sha256(self.as_json().encode()).hexdigest()

    def as_json(self) -> str:
        """As the ledger keeps it."""
        return json.dumps(self.parts)

    @classmethod
    def from_json(cls, text: str) -> Identity:
        """As it was kept; ValueError or TypeError for any other text."""
        return cls(tuple((str(name), str(value)) for name, value in json.loads(text)))

    def changes(self, now: Identity) -> list[str]:
        """What is another now, in words; empty if nothing is."""
        before, after = dict(self.parts), dict(now.parts)
        words = [f"{name} changed" for name in before if name in after and before[name] != after[name]]
        words += [f"{name} is gone" for name in before if name not in after]
        return words + [f"{name} is new" for name in after if name not in before]


def identity_of(
    files: Sequence[PlanFile], spaces: Sequence[ScenarioSpace], avoider: str | None, world: str
) -> Identity:
    """Of a plan's files, the shipped networks that they name, this package and its libraries."""
    parts = {f"the file {file.name}": file.sha256 for file in files}
    named = {avoider or ""} | {text for space in spaces for text in references_in(space.tree)}
    named |= {space.simplest.avoider for space in spaces}  # the default, of a space that names none
    for name in sorted(named & set(SHIPPED)):
        parts[f"the network {name}"] = hashlib.sha256(shipped_model(name).read_bytes()).hexdigest()
    import_module("safety_harness.simulation.pybullet_world")  # the same libraries are loaded, whoever asks
    made_by = provenance(world, "")
    parts["the source of this package"] = made_by.source_hash
    parts["Python"] = made_by.python
    parts["the platform"] = made_by.platform
    parts |= {f"the library {name}": version for name, version in made_by.libraries}
    return Identity(tuple(parts.items()))


def stratum_number(name: str) -> int:
    """The number of a stratum in the tree of seeds: 63 bits of its name's SHA-256."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big") >> 1
