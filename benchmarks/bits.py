"""What a change of the source changes in results: two revisions, the same commands, every difference.

Run: python benchmarks/bits.py BASE [AFTER] [--whole] [--item NAME]...  (make bits BASE=REVISION)

Installs BASE and AFTER (the working tree if it is not given), one after the other in the same place, with the
libraries of this environment.  Both run the same commands on their own shipped files.  The script knows
command lines and the names at the root of the package only, so a revision may move any module.

Arrays of traces, files of searches, and every number, verdict, claim, identifier and exit code are compared
to the last bit.  The report lists all that was left out.  Prose is compared as well but not counted.
Ends with 1 if anything differs.

Results of a revision are kept in reports/bits by the hash of its tree, of the scripts and of the libraries:
BASE is run once, and AFTER is always run.  Both sides share the machine code of kernels that have the same
place and the same imports; a kernel that moved, or that imports a file that moved, is compiled again.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import io
import json
import os
import re
import resource
import shutil
import sqlite3
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict, dataclass, field
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, Final

from bits_items import ASK, ITEMS, Item

ROOT: Final = Path(__file__).resolve().parents[1]
PLACE: Final = ROOT / "reports" / "bits"
SITE, SOURCE, OUT, EARLIER = (PLACE / name for name in ("site", "source", "out", "earlier"))
RESULTS, MACHINE_CODE = PLACE / "results", PLACE / "machine-code"
SCRIPTS: Final = ("bits.py", "bits_items.py")  # a change of theirs makes kept results old
SHOWN: Final = 12  # differences of an item
PROSE_SHOWN: Final = 3
# Of texts: hashes, and the root over rows, which hold the source hash.
HASHES: Final = r"\b[0-9a-f]{64}\b|(?<=Root over all rows )[0-9a-f]{12}"

# What is not compared of JSON documents, with all that lies below it, and why: the end of the path of keys.
LEFT_OUT: Final = {
    r"made_at|generated_at|began_at|ended_at": "times of day",
    r"provenance|source_hash|package_version|machine|python": "the source, and where it ran",
    r"trace_sha256|files|rows_sha256|plan\.sha256": "hashes that cover the source or computing times",
    r"computing_time|times|seconds|run_seconds_s": "computing times",
    r"repeatability\.asked": "runs that were repeated, as many as time allows",
}
LEFT_OUT_PATTERN: Final = re.compile(rf"(?:.*\.)?(?:{'|'.join(LEFT_OUT)})")
# Of a ledger.
LEFT_OUT_TABLES: Final = {"about", "session", "repeated", "answering", "sqlite_sequence"}
LEFT_OUT_COLUMNS: Final = {"seconds", "worker"}
LEFT_OUT_MEMBERS: Final = {"latencies.npy"}
# Pages and drawings: their numbers are in the documents beside them, with times of day in between.
LEFT_OUT_FILES: Final = {".html", ".sarif", ".md", ".xml", ".svg", ".sqlite-wal", ".sqlite-shm", ".lock"}
LEFT_OUT_NAMES: Final = {"manifest.json"}
MODULE: Final = re.compile(r"safety_harness(?:[./][A-Za-z_][\w-]*)+")  # a module, or a file of the package
# Text under these keys is compared as a value; other text that has a space in it is prose.
SENTENCES: Final = re.compile(
    r"claim|sentence|scenario|name|title|property|verdict|unit|stratum|space|fault|format"
)


@dataclass
class Result:
    """All that one revision gave for an item: {place: value as JSON text}."""

    values: dict[str, str] = field(default_factory=dict)
    prose: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, int] = field(default_factory=dict)
    modules: int = 0  # texts in which the name of a module was replaced
    seconds: float = 0.0
    compiled: int = 0  # functions of which machine code was made meanwhile


def main() -> int:
    """Run both revisions and print what differs; 1 if anything does."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("base", help="the revision before the change")
    parser.add_argument("after", nargs="?", help="the revision after it; the working tree if not given")
    parser.add_argument("--whole", action="store_true", help="all items, not only the quick ones")
    parser.add_argument("--item", action="append", default=[], help="only items whose name contains this")
    parser.add_argument("--afresh", action="store_true", help="run the base again as well")
    options = parser.parse_args()
    items = [Item("command lines, public names, formats", "")] + [
        item for item in ITEMS if item.quick or options.whole or options.item
    ]
    if options.item:
        items = [item for item in items if any(part in item.name for part in options.item)]
    if not items:
        parser.error(f"no item is named so; there are: {', '.join(item.name for item in ITEMS)}")
    PLACE.mkdir(parents=True, exist_ok=True)
    lock = (PLACE / "lock").open("w")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        parser.error(f"another comparison runs in {PLACE}")
    base, after = _tree(options.base), _tree(options.after)
    before = _results(base, items, kept=not options.afresh, side="base")
    now = _results(after, items, kept=False, side="after")
    different = [item.name for item in items if _compare(item.name, before[item.name], now[item.name])]
    _print_left_out([*before.values(), *now.values()])
    print(f"DIFFERENT: {', '.join(different)}" if different else "no difference")
    return int(bool(different))


def _git(*words: str, **environment: str) -> str:
    """Return what git prints."""
    done = subprocess.run(
        ["git", *words], cwd=ROOT, env={**os.environ, **environment}, check=True, capture_output=True
    )
    return done.stdout.decode().strip()


def _tree(revision: str | None) -> str:
    """Return the hash of the tree of a revision, or of the working tree with its untracked files."""
    if revision is not None:
        return _git("rev-parse", "--verify", f"{revision}^{{tree}}")
    with tempfile.TemporaryDirectory() as folder:
        index = str(Path(folder, "index"))
        _git("read-tree", "HEAD", GIT_INDEX_FILE=index)
        _git("add", "--all", GIT_INDEX_FILE=index)
        return _git("write-tree", GIT_INDEX_FILE=index)


def _results(tree: str, items: list[Item], *, kept: bool, side: str) -> dict[str, Result]:
    """Return the result of each item; runs those that are not kept from an earlier time."""
    made_with = hashlib.sha256(b"".join(Path(__file__).with_name(name).read_bytes() for name in SCRIPTS))
    made_with.update(repr(sorted(f"{one.name} {one.version}" for one in distributions())).encode())
    folder = RESULTS / f"{tree[:16]}-{made_with.hexdigest()[:8]}"
    files = {item.name: folder / (re.sub(r"\W+", "-", item.name) + ".json") for item in items}
    waiting = [item for item in items if not (kept and files[item.name].is_file())]
    if waiting:
        _print_seconds(f"{side} {tree[:12]}: installed", _install, tree)
        if len(items) > len(ITEMS) // 2:  # less makes what it needs itself
            _print_seconds(f"{side} {tree[:12]}: machine code", _run, ["warm"])
        began, cpu = time.monotonic(), _cpu_seconds()
        folder.mkdir(parents=True, exist_ok=True)
        with ThreadPoolExecutor(2) as pool:
            for item, result in zip(waiting, pool.map(_result, waiting), strict=True):
                files[item.name].write_text(json.dumps(asdict(result)))
                note = f", {result.compiled} functions compiled meanwhile" if result.compiled else ""
                print(f"    {result.seconds:6.1f} s  {item.name}{note}", flush=True)
        took = f"{time.monotonic() - began:.0f} s, {_cpu_seconds() - cpu:.0f} s of processors"
        print(f"{side} {tree[:12]}: {len(waiting)} items in {took}", flush=True)
    if len(waiting) < len(items):
        print(
            f"{side} {tree[:12]}: {len(items) - len(waiting)} items kept from before in {folder}", flush=True
        )
    return {name: Result(**json.loads(file.read_text())) for name, file in files.items()}


def _print_seconds(what: str, work: Any, *arguments: Any) -> None:
    """Call ``work`` and print how long it took."""
    began, cpu, before = time.monotonic(), _cpu_seconds(), _machine_code()
    work(*arguments)
    made = _machine_code() - before
    note = f", {made} functions compiled" if made else ""
    took = f"{time.monotonic() - began:.0f} s, {_cpu_seconds() - cpu:.0f} s of processors"
    print(f"{what} in {took}{note}", flush=True)


def _cpu_seconds() -> float:
    """Return what the programs that ended have computed: on a busy machine the clock says little."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _machine_code() -> int:
    """Count the compiled functions that are kept."""
    return sum(1 for _ in MACHINE_CODE.rglob("*.nbc"))


def _install(tree: str) -> None:
    """Put the source of a tree, its installed package, and files of earlier versions in their places."""
    for folder in (SITE, SOURCE, OUT, EARLIER):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
    archive = subprocess.run(["git", "archive", tree], cwd=ROOT, capture_output=True, check=True).stdout
    subprocess.run(["tar", "-x", "-C", SOURCE], input=archive, check=True)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
    subprocess.run([*pip, "--target", str(SITE), str(SOURCE)], check=True, stdout=sys.stderr)
    for file in sorted(SOURCE.glob("tests/**/earlier/*")):  # wherever the tests have them
        if file.name.endswith(".tar.xz"):
            with tarfile.open(file) as packed:
                packed.extractall(EARLIER, filter="data")
        else:
            shutil.copy(file, EARLIER)


def _run(arguments: list[str], *program: str) -> subprocess.CompletedProcess[str]:
    """Run a command of the installed revision in its source."""
    paths = os.pathsep.join(map(str, (SITE, SOURCE / "paper")))
    environment = {**os.environ, "PYTHONPATH": paths, "SAFETY_HARNESS_CACHE": str(MACHINE_CODE)}
    environment |= {"COLUMNS": "200", "NO_COLOR": "1", "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": ""}
    command = [sys.executable, "-P", *(program or ("-m", "safety_harness")), *arguments]
    return subprocess.run(command, cwd=SOURCE, env=environment, capture_output=True, text=True)


def _result(item: Item) -> Result:
    """Run an item and take in all that it wrote."""
    began, compiled = time.monotonic(), _machine_code()
    folder = OUT / re.sub(r"\W+", "-", item.name)
    out, plan = folder / "report", folder / "plan.yaml"
    folder.mkdir()
    plan.write_text(item.plan)
    if item.command:
        places = {"out": out, "earlier": EARLIER, "plan": plan}
        words = item.command.format(**{key: os.path.relpath(place, SOURCE) for key, place in places.items()})
        done = _run([word for each in words.split() for word in _expanded(each)])
    else:
        done = _run([], "-c", ASK)
    result = Result()
    written = sorted(file for file in out.rglob("*") if file.is_file()) if out.exists() else []
    for file in written:
        _take_file(result, str(file.relative_to(out)), file)
    if ("{out}" in item.command and not result.values) or not (written or done.stdout or done.stderr):
        sys.exit(
            f"{item.name}: nothing was written; {done.stderr[-800:]}"
        )  # two that fail alike would be equal
    result.values["exit code"] = json.dumps(done.returncode)
    if done.stdout.lstrip().startswith(("{", "[")):
        _take_json(result, "standard output", json.loads(done.stdout))
    else:
        for number, line in enumerate(done.stdout.splitlines()):
            _take(result, f"standard output, line {number + 1}", line, prose=True)
    result.seconds, result.compiled = time.monotonic() - began, _machine_code() - compiled
    return result


def _expanded(word: str) -> list[str]:
    """Return the files that a pattern names, or the word itself."""
    return sorted(os.path.relpath(file, SOURCE) for file in SOURCE.glob(word)) if "*" in word else [word]


def _take_file(result: Result, name: str, file: Path) -> None:
    """Take in the places of a file that have to stay equal."""
    if file.suffix in LEFT_OUT_FILES:
        _leave_out(result, file.suffix)
    elif file.name in LEFT_OUT_NAMES:
        _leave_out(result, file.name)
    elif file.suffix == ".json":
        _take_json(result, name, json.loads(file.read_text()))
    elif file.suffix == ".sqlite":
        _take_ledger(result, name, file)
    elif file.suffix == ".trace":
        _take_trace(result, name, file.read_bytes())
    elif file.name.endswith(".gsn.yaml"):  # names the hashes of the evidence
        _take(result, f"{name}: text", re.sub(HASHES, "<hash>", file.read_text()))
    else:
        _take(result, f"{name}: bytes", hashlib.sha256(file.read_bytes()).hexdigest()[:16])


def _take_ledger(result: Result, name: str, file: Path) -> None:
    """Take in the rows of a ledger: each episode, judgement and trace."""
    with closing(sqlite3.connect(file)) as ledger:
        tables = ledger.execute(
            "SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name"
        ).fetchall()
        for (table,) in tables:
            if table in LEFT_OUT_TABLES:
                _leave_out(result, f"table {table}")
                continue
            rows = ledger.execute(f"SELECT * FROM {table}")
            columns = [column[0] for column in rows.description]
            for number, row in enumerate(rows):
                for column, value in zip(columns, row, strict=True):
                    place = f"{name}: {table}.{number}.{column}"
                    if table == "trace" and column == "data":
                        _take_trace(result, place, value)
                    elif column in LEFT_OUT_COLUMNS:
                        _leave_out(result, f"column {column}")
                    else:
                        data = isinstance(value, bytes)
                        _take(result, place, hashlib.sha256(value).hexdigest()[:16] if data else value)


def _take_trace(result: Result, name: str, data: bytes) -> None:
    """Take in the arrays of a trace, its scenario and what it says of the run."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for member in archive.namelist():
            if member in LEFT_OUT_MEMBERS:
                _leave_out(result, member)
            elif member == "trace.json":  # the format, and hashes of the others
                _take(result, f"{name}: format", json.loads(archive.read(member))["format"])
            elif member.endswith(".json"):
                _take_json(result, f"{name}: {member}", json.loads(archive.read(member)))
            else:
                _take(result, f"{name}: {member}", hashlib.sha256(archive.read(member)).hexdigest()[:16])


def _take_json(result: Result, name: str, document: object) -> None:
    """Take in every leaf of a document but those below a key of ``LEFT_OUT``."""
    for place, key, value in _leaves("", "", document, result):
        prose = isinstance(value, str) and " " in value and not SENTENCES.fullmatch(key)
        _take(result, f"{name}: {place.lstrip('.')}", value, prose=prose)


def _leaves(path: str, place: str, value: object, result: Result) -> Iterator[tuple[str, str, object]]:
    """List the leaves of a document: the place, the last key that is a name, and the value."""
    if isinstance(value, dict):
        for name, inner in value.items():
            if LEFT_OUT_PATTERN.fullmatch(f"{path}.{name}"):
                _leave_out(result, name)
            else:
                yield from _leaves(f"{path}.{name}", f"{place}.{name}", inner, result)
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from _leaves(path, f"{place}.{number}", inner, result)
    else:
        yield place, path.rpartition(".")[2], value


def _take(result: Result, place: str, value: object, *, prose: bool = False) -> None:
    """Take in a value, with the names of modules in it replaced."""
    if isinstance(value, str):
        value, replaced = MODULE.subn("<module>", value)
        result.modules += bool(replaced)
    (result.prose if prose else result.values)[place] = json.dumps(value)


def _leave_out(result: Result, what: str) -> None:
    """Count something that is not compared."""
    result.left_out[what] = result.left_out.get(what, 0) + 1


def _compare(name: str, before: Result, after: Result) -> bool:
    """Print whether an item is equal, else the first differences; True if it is not."""
    places = _differing(before.values, after.values)
    prose = _differing(before.prose, after.prose)
    total = len({**before.values, **after.values})
    print(f"{'different' if places else 'equal':10}{name}: {len(places)} of {total} values differ")
    _print_places(places, before.values, after.values, SHOWN)
    if prose:
        print(f"          prose, not counted: {len(prose)} of {len(before.prose | after.prose)} texts differ")
        _print_places(prose, before.prose, after.prose, PROSE_SHOWN)
    return bool(places)


def _differing(before: dict[str, str], after: dict[str, str]) -> list[str]:
    """List the places of which one side has another value, or none."""
    return [place for place in {**before, **after} if before.get(place) != after.get(place)]


def _print_places(places: list[str], before: dict[str, str], after: dict[str, str], most: int) -> None:
    for place in places[:most]:
        print(f"    {place}: {before.get(place, 'missing')} -> {after.get(place, 'missing')}")
    if len(places) > most:
        print(f"    and {len(places) - most} more")


def _print_left_out(results: list[Result]) -> None:
    """Say what was not compared, with how often it was there on both sides together."""
    left_out: Counter[str] = Counter()
    for result in results:
        left_out.update(result.left_out)
    print("not compared:")
    for keys, reason in LEFT_OUT.items():
        print(f"    {reason}: keys {keys.replace('|', ', ')}")
    print("    files: " + ", ".join(sorted(LEFT_OUT_FILES | LEFT_OUT_NAMES | LEFT_OUT_MEMBERS)))
    print("    how often: " + ", ".join(f"{what} {number}" for what, number in sorted(left_out.items())))
    print(
        f"    names of modules, replaced in {sum(result.modules for result in results)} texts; standard error"
    )


if __name__ == "__main__":
    sys.exit(main())
