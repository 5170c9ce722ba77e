"""What a change of the source changes in results: two revisions, the same commands, every difference.

Run: python benchmarks/bits.py BASE [--whole] [--item NAME]...  (make bits BASE=REVISION)

Installs BASE and the working tree, each into a folder of its own, with the libraries of this environment.
Both run the same commands on their own shipped files.  The arrays of every trace, the files of every search,
and every number, verdict, claim and identifier of every JSON document are compared to the last bit.  Prose,
times of day, computing times, versions and hashes of the source are not.  Ends with 1 if anything differs.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]
DIFFERENCES_SHOWN: Final = 12
# Fields that differ between two runs of one source, or that name the source itself.
PASSING: Final = re.compile(
    r"(^|\.)(made_at|provenance|source_hash|source_sha256|package_version|versions?|trace_sha256|manifest.*|machine|"
    r"computing_time.*|latency.*|.*duration.*|.*seconds.*|.*elapsed.*|began|ended_at|.*_at|file|selftest)(\.|$)"
)
SENTENCES: Final = re.compile(
    r"(^|\.)(claim|sentence|scenario|name|title|property|verdict|unit|stratum|space)$"
)
IGNORED_FILES: Final = {"summary.md", "report.html", "report.sarif", "junit.xml", "manifest.json"}


@dataclass(frozen=True)
class Item:
    """Something to compare: the arguments of a command, "{out}" being the folder it writes."""

    name: str
    command: str
    quick: bool


SPACES: Final = (
    "reaching-hands",
    "unseen-both",
    "nominal",
    "unseen-hand",
    "unseen-tcp",
    "recorded-variations",
)
ITEMS: Final = (
    Item("scenarios, kinematic", "run scenarios --world kinematic --keep-going --jobs 2 --out {out}", True),
    Item("scenarios, PyBullet", "run scenarios --jobs 2 --out {out}", False),
    *(
        Item(
            f"search of {name}",
            f"fuzz scenarios/spaces/{name}.yaml --budget 100 --out {{out}}",
            name == SPACES[0],
        )
        for name in SPACES
    ),
    Item("plan quick", "certify plans/quick.yaml --out {out}", True),
    Item("plan certify-in-a-minute", "certify plans/certify-in-a-minute.yaml --out {out}", False),
    Item("score", "evaluate optimum student --questions 200 --search 0 --out {out}", True),
    Item("proofs", "prove plans/student-proofs.yaml --minutes 0.5 --out {out}", False),
    Item("self-test", "selftest --scenarios shipped:scenarios --jobs 2 --out {out}", False),
    Item("traces of earlier versions", "judge tests/trace/earlier --json", True),
    Item("a file that is not there", "run nothing.yaml", True),
    Item("a file of another kind", "run plans/quick.yaml", True),
    Item("claims", "claims --json", True),
    Item("schema", "schema", True),
    Item("shipped", "list", True),
)


def main() -> int:
    """Run both revisions and print what differs; 1 if anything does."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("base", help="the revision before the change")
    parser.add_argument("--whole", action="store_true", help="all items, not only the quick ones")
    parser.add_argument("--item", action="append", default=[], help="only items whose name contains this")
    options = parser.parse_args()
    items = [
        item
        for item in ITEMS
        if (any(part in item.name for part in options.item) if options.item else options.whole or item.quick)
    ]
    different = False
    with tempfile.TemporaryDirectory(prefix="bits-") as folder:
        before, after = (
            _installed(options.base, Path(folder, "before")),
            _installed(None, Path(folder, "after")),
        )
        different |= _report("command lines", _command_lines(before), _command_lines(after))
        for item in items:
            different |= _report(item.name, _values(before, item), _values(after, item))
    return int(different)


def _installed(revision: str | None, folder: Path) -> Path:
    """Install a revision, or the working tree, into FOLDER/site; its source is FOLDER/source."""
    source = folder / "source"
    source.mkdir(parents=True)
    if revision is None:
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=ROOT,
            capture_output=True,
            check=True,
        ).stdout.decode()
        for name in filter(None, listed.split("\0")):
            if (ROOT / name).is_file():
                (source / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, source / name)
    else:
        archive = subprocess.run(
            ["git", "archive", revision], cwd=ROOT, capture_output=True, check=True
        ).stdout
        subprocess.run(["tar", "-x", "-C", source], input=archive, check=True)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
    subprocess.run([*pip, "--target", str(folder / "site"), str(source)], check=True, stdout=sys.stderr)
    return folder


def _run(folder: Path, arguments: list[str]) -> subprocess.CompletedProcess[str]:
    """Run the command of a revision in its own source, so that paths are the same for both."""
    environment = {**os.environ, "PYTHONPATH": str(folder / "site"), "COLUMNS": "200", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-P", "-m", "safety_harness", *arguments]
    return subprocess.run(command, cwd=folder / "source", env=environment, capture_output=True, text=True)


def _values(folder: Path, item: Item) -> dict[str, object]:
    """Run an item and flatten all that it wrote: {place: value}."""
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    done = _run(folder, item.command.format(out="../out").split())
    values: dict[str, object] = {"exit code": done.returncode}
    for file in sorted(file for file in out.rglob("*") if file.is_file()) if out.exists() else ():
        values.update((f"{file.relative_to(out)}: {place}", value) for place, value in _of_file(file))
    if "{out}" in item.command and len(values) == 1:  # or two that fail alike would be equal
        sys.exit(f"{item.name}: {folder.name} wrote nothing; {done.stderr[-500:]}")
    if done.stdout.lstrip().startswith(("{", "[")):
        values.update((f"standard output: {place}", value) for place, value in _of_json(done.stdout))
    elif not out.exists():
        values["standard output"] = done.stdout
    return values


def _of_file(file: Path) -> Iterator[tuple[str, object]]:
    """List the places of a file that have to stay equal, with their values."""
    if file.suffix == ".json" and file.name not in IGNORED_FILES:
        yield from _of_json(file.read_text())
    elif file.suffix == ".trace":
        with zipfile.ZipFile(file) as archive:
            for name in archive.namelist():
                if name.endswith((".npy", ".yaml")) and name != "latencies.npy":
                    yield name, hashlib.sha256(archive.read(name)).hexdigest()[:16]
    elif file.suffix in {".yaml", ".csv"}:
        yield "bytes", hashlib.sha256(file.read_bytes()).hexdigest()[:16]


def _of_json(text: str) -> Iterator[tuple[str, object]]:
    """Flatten a document; leaves out prose and what passes (times, versions, hashes of the source)."""
    waiting: list[tuple[str, object]] = [("", json.loads(text))]
    while waiting:
        place, value = waiting.pop()
        if PASSING.search(place):
            continue
        if isinstance(value, dict):
            waiting += [(f"{place}.{key}".lstrip("."), inner) for key, inner in value.items()]
        elif isinstance(value, list):
            waiting += [(f"{place}.{number}", inner) for number, inner in enumerate(value)]
        elif not (isinstance(value, str) and " " in value and not SENTENCES.search(place)):
            yield place, value


def _command_lines(folder: Path) -> dict[str, object]:
    """List the options of every command, from its help."""
    found: dict[str, object] = {}
    waiting: list[tuple[str, ...]] = [()]
    while waiting:
        words = waiting.pop()
        text = _run(folder, [*words, "--help"]).stdout
        commands = text.partition("─ Commands ─")[2]
        waiting += [(*words, name) for name in re.findall(r"^│ ([a-z][a-z-]*) ", commands, re.MULTILINE)]
        found[" ".join(words)] = tuple(sorted(set(re.findall(r"(?<=[ │])--?[a-z][a-z-]*", text))))
    return found


def _report(name: str, before: dict[str, object], after: dict[str, object]) -> bool:
    """Print whether an item is equal, else the first differences; True if it is not."""
    missing = object()
    places = [
        place for place in {**before, **after} if before.get(place, missing) != after.get(place, missing)
    ]
    total, state = len({**before, **after}), "different" if places else "equal"
    print(f"{state:10}{name}: {len(places)} of {total} values differ", flush=True)
    for place in places[:DIFFERENCES_SHOWN]:
        print(f"    {place}: {before.get(place, 'missing')!r} -> {after.get(place, 'missing')!r}")
    if len(places) > DIFFERENCES_SHOWN:
        print(f"    and {len(places) - DIFFERENCES_SHOWN} more")
    return bool(places)


if __name__ == "__main__":
    sys.exit(main())
