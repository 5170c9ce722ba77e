"""The identity of a plan, which lists its files and everything else that its results depend on.

Each entry has a name, and a hash or a version. A comparison of two identities lists the changed entries. The
files in an identity suffice to read the plan on another machine, or after the user has changed the originals.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

from safety_harness.base.exceptions import InadmissibleError, LedgerError, Place, ScenarioError
from safety_harness.base.shipped.contents import PREFIX, contents, is_installed, located
from safety_harness.base.whole_file import writing
from safety_harness.cell.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.cell.controller.out_of_process.references import program_sha256
from safety_harness.cell.robot.robots import arm_model
from safety_harness.cell.simulation.worlds import libraries_of, world_labelled
from safety_harness.scenario.compose import Library
from safety_harness.scenario.files import read_bytes, resolved
from safety_harness.scenario.model import EDITION
from safety_harness.scenario.nodes import TESTED, references_in
from safety_harness.scenario.references import file_and_name
from safety_harness.scenario.robots import AnyRobot, OwnRobot
from safety_harness.scenario.urdf_packages import urdf_of_package
from safety_harness.space.space import ScenarioSpace
from safety_harness.trace.provenance import provenance
from safety_harness.trace.system import SystemUnderTest

SYSTEM = "the system under test"
CLAIMS = "the meaning of the claims"
SIMULATOR = "the simulator"
UNKNOWN_SIMULATOR = "of unknown content"  # a program that listens


@dataclass(frozen=True)
class Identity:
    """Everything on which the results depend (files, networks, libraries), with hashes or versions."""

    parts: tuple[tuple[str, str], ...]

    @property
    def sha256(self) -> str:
        """The SHA-256 of all parts."""
        return hashlib.sha256(self.as_json().encode()).hexdigest()

    def as_json(self) -> str:
        """Return the text that the ledger stores."""
        return json.dumps(self.parts)

    @classmethod
    def from_json(cls, text: str) -> Identity:
        """Return the identity in a stored text.

        Raise ValueError or TypeError if the text is wrong or repeats an entry.
        """
        parts = tuple((str(name), str(value)) for name, value in json.loads(text))
        if len(dict(parts)) < len(parts):
            raise ValueError("a part occurs twice")
        return cls(parts)

    @property
    def systems(self) -> list[str]:
        """The distinct systems under test, as text."""
        return sorted({text for name, text in self.parts if name.startswith(SYSTEM)})

    def changes(self, now: Identity) -> list[str]:
        """Return a line for each change from this identity to ``now``, or an empty list if the two are equal.

        A changed system under test is listed only if no file, network or version has changed.
        """
        old, new = dict(self.parts), dict(now.parts)
        lines = [f"{name} changed" for name in old if name in new and old[name] != new[name]]
        lines += [f"{name} is gone" for name in old if name not in new]
        lines += [f"{name} is new" for name in new if name not in old]
        # A changed file or version usually changes the system too, and explains it better.
        return [line for line in lines if not line.startswith(SYSTEM)] or lines

    def refuse_other(self, now: Identity, file: Path, *, where: str = "", hint: str = "") -> None:
        """Raise LedgerError unless ``now`` equals this identity.

        The error for ``file`` lists the changes.
        """
        if changes := self.changes(now):
            expected = f"the plan, files and versions of its first run{where}"
            raise LedgerError(place=Place(file=file), expected=expected, got="; ".join(changes), hint=hint)


def identity_of(
    files: Sequence[PlanFile],
    spaces: Sequence[ScenarioSpace],
    avoider: str | None,
    world: str,
    systems: Iterable[tuple[str, SystemUnderTest]] = (),
    edition: int = EDITION,
) -> Identity:
    """Return the identity of a plan: its files, shipped networks, this package and its libraries.

    ``systems`` has pairs of a stratum's name and its system under test. ``edition`` is the edition of the
    catalogue that gives the claims their meaning.
    """
    parts = {f"the file {file.name}": file.sha256 for file in files}
    named = {avoider or ""} | {text for space in spaces for text in references_in(space.tree)}
    named |= {space.simplest.avoider for space in spaces}  # the default avoider, if a space names no avoider
    for name in sorted(named & set(SHIPPED)):
        parts[f"the network {name}"] = hashlib.sha256(shipped_model(name).read_bytes()).hexdigest()
    made_by = provenance(world, _libraries(spaces, world))
    parts["the source of this package"] = made_by.source_hash
    if edition > 1:  # ledgers of edition 1 do not state it
        parts[CLAIMS] = f"edition {edition}"
    parts["Python"] = made_by.python
    parts["the platform"] = made_by.platform
    parts |= {f"the library {name}": version for name, version in made_by.libraries}
    parts |= _simulator(world)
    parts |= {f"{SYSTEM} in {name}": system.as_json for name, system in systems}
    return Identity(tuple(parts.items()))


def edition_of(identity: Identity) -> int:
    """Return the edition of the catalogue of claims for a ledger, or 1 if the ledger states no edition."""
    edition = dict(identity.parts).get(CLAIMS, "edition 1").removeprefix("edition ")
    return int(edition) if edition in map(str, range(1, EDITION)) else EDITION


def _libraries(spaces: Sequence[ScenarioSpace], world: str) -> tuple[str, ...]:
    """Return the distinct libraries that the runs use.

    If an engine is missing, the entry of the engine states that it is not loaded.
    """
    entry = world_labelled(world)
    assert entry is not None
    used = (libraries_of(entry.name, space.simplest) for space in spaces)
    return tuple(dict.fromkeys(chain(entry.libraries * entry.is_installed, *used)))


def _simulator(world: str) -> dict[str, str]:
    """Return the hash of the user's simulator as an entry of an identity.

    The result is empty if the world is not a user's simulator.
    """
    entry = world_labelled(world)
    if entry is None or not entry.program:
        return {}
    with suppress(InadmissibleError):  # no such program here
        sha256 = program_sha256(world, Place(field="world"))
        return {SIMULATOR: f"sha256 {sha256}" if sha256 else UNKNOWN_SIMULATOR}
    return {SIMULATOR: "not found"}


MOST_BYTES = 200_000_000  # of all files together


@dataclass(frozen=True)
class PlanFile:
    """The bytes of one file of a plan, and its name relative to the common folder of all files."""

    name: str
    data: bytes = field(repr=False)

    @property
    def sha256(self) -> str:
        """The SHA-256 of the bytes."""
        return hashlib.sha256(self.data).hexdigest()


def files_of_plan(
    plan: Path,
    library: Library,
    spaces: Sequence[ScenarioSpace],
    avoider: str | None,
    further: Sequence[Path] = (),
) -> tuple[PlanFile, ...]:
    """Return all files of a plan, beginning with the plan's own file.

    The other files are the spaces, the files that they extend, recordings, avoiders and robot models.
    ``further`` lists additional files from which the plan was read. Files that a user's avoider imports or
    opens are not in the result. Raise ScenarioError if the files together are larger than MOST_BYTES.
    """
    named = [plan.resolve(), *library.files, *further]
    for space in spaces:
        tested = (file_and_name(text)[0] for text in references_in(space.tree, TESTED))
        folder = space.file.parent if space.file else Path()
        named += _existing((*tested, *references_in(space.tree, ("recording",))), folder)
        named += _existing(map(str, _files_of(space.simplest.robot)), Path())
    if avoider is not None:
        named += _existing([file_and_name(avoider)[0]], plan.parent)
    files, size = [], 0
    names = _names(named)
    for path, name in names.items():
        data = read_bytes(path, most=MOST_BYTES, place=Place(file=path), error=ScenarioError)
        size += len(data)
        if size > MOST_BYTES:
            raise ScenarioError.of_file(plan, f"at most {MOST_BYTES:,} bytes of files", "more")
        files.append(PlanFile(name, _packed(data, path, names)))
    return tuple(files)


_ABSOLUTE = re.compile(rb"""(?<=["'])[~/][^"'\n]*(?=["'])|(?<=[\s\[{,])[~/][^\s"'\[\]{},#:]+""")


def _packed(data: bytes, path: Path, names: dict[Path, str]) -> bytes:
    """Return a file's content in which absolute paths of other packed files are replaced by relative paths.

    Thus a copy of the plan in a report refers to the copied files in the same report, even if the report is
    moved.
    """
    if path.suffix not in (".yaml", ".yml", ".urdf"):
        return data
    folder = Path(names[path]).parent

    def relative(match: re.Match[bytes]) -> bytes:
        text = match[0].decode("utf-8", "replace")
        file, name = file_and_name(text)
        target = next(_existing([file or text], Path()), None)
        if target not in names:
            return match[0]
        return (os.path.relpath(names[target], folder) + f":{name}" * bool(name)).encode()

    return _ABSOLUTE.sub(relative, data)


def _files_of(robot: AnyRobot) -> Iterator[Path]:
    """Yield the files and meshes of a user's arm, except the files of an installed package."""
    if isinstance(robot, OwnRobot):
        packaged = _is_packaged(robot)
        yield from robot.files[packaged:]
        shapes = (shape for link in arm_model(robot).links for shape in (*link.collision, *link.visual))
        yield from {shape.file: None for shape in shapes if shape.file is not None and not packaged}


def _is_packaged(robot: OwnRobot) -> bool:
    """Return True if the arm's URDF is in an installed package.

    If so, the meshes come from the same package.
    """
    with suppress(ScenarioError):
        return robot.package is not None and urdf_of_package(robot.package, Place()) == robot.files[0]
    return False


def _names(paths: Sequence[Path]) -> dict[Path, str]:
    """Return each file's name relative to the common folder.

    Shipped files may be below a folder ``shipped``. A copy of the plan finds its "shipped:" files in that
    folder on any machine. The function uses the folder if the package is installed, or if a user's file
    contains "shipped:". The function never uses the folder for a plan that itself ships with the package.
    """
    ours = {path for path in paths if contents() in path.parents}
    own = [path for path in paths if path not in ours]
    if paths[0] in ours or not (is_installed() or any(map(_says_shipped, own))):
        ours, own = set(), list(paths)
    root = Path(os.path.commonpath([path.parent for path in own]))
    return {
        path: f"shipped/{path.relative_to(contents()).as_posix()}"
        if path in ours
        else path.relative_to(root).as_posix()
        for path in paths
    }


def _says_shipped(path: Path) -> bool:
    return path.suffix in (".yaml", ".yml") and PREFIX.encode() in path.read_bytes()


def unpacked(files: Sequence[PlanFile], folder: Path) -> Path:
    """Write ``files`` below ``folder`` and return the path of the plan's own file, which comes first.

    Raise ScenarioError if the name of a file leads out of ``folder``.
    """
    for file in files:
        path = (folder / file.name).resolve()
        if folder.resolve() not in path.parents:
            raise ScenarioError.of_file(Path(file.name), "a file below the plan's folder", "another")
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(file.data)
    return (folder / files[0].name).resolve()


def _existing(references: Iterable[str], folder: Path) -> Iterator[Path]:
    for file in references:
        try:
            path = resolved(located(folder / os.path.expanduser(file)))
            if file and path.is_file():
                yield path
        except (OSError, ValueError):  # too long for a name, or no name at all
            continue
