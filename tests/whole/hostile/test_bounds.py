"""What would fill the memory or wait for ever ends soon, within half a gigabyte, in an error."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from safety_harness.base.exceptions import InputError
from tests.whole.hostile.formats import FORMATS, Format, repacked, trace_bytes

ROOM_BYTES = 512 << 20
SECONDS = 300  # far more than it takes, on however busy a machine


BOMBS: dict[str, dict[str, Callable[[], bytes]]] = {  # contents that promise much more than they are
    ".trace": {
        "a bomb": lambda: repacked(trace_bytes(), ticks_npy=b"\0" * (640 << 20)),
        "a long directory": lambda: b"PK\5\6" + b"\0" * 8 + b"\xff" * 8 + b"\0" * 2,
    },
    ".safetensors": {"an endless header": lambda: (1 << 62).to_bytes(8, "little") + b"{" * 1_000},
    ".csv": {
        "one line": lambda: b"time_s," + b"1," * 9_000_000,
        "commas": lambda: b"," * 19_000_000,
    },
    ".yaml": {
        "brackets": lambda: b"[" * 999_000,
        "quotes": lambda: b'"' * 999_000,
        "dashes": lambda: b"- " * 499_000,
    },
}
CASES = [
    (kind, name)
    for kind in FORMATS
    for name in BOMBS.get(Path(kind.file).suffix, {})
    if kind.name not in ("space", "suite", "extending scenario", "kept failure")  # read by the same reader
]


def held() -> int:
    """Bytes of data that this process holds."""
    words = Path("/proc/self/status").read_text().split("VmData:")[1].split()[0]
    return int(words) * 1_024


def try_all(folder: Path) -> None:
    """In a process of its own: every kind of file, without end, as a pipe, and as a bomb."""
    cases: list[tuple[str, Format, Path]] = []
    for kind in FORMATS:
        for name in ("whole", "huge", "pipe"):
            place = folder / f"{kind.name}, {name}"
            place.mkdir()
            path = kind.put(place, kind.whole())
            if name == "huge":
                os.truncate(path, 1 << 40)
            elif name == "pipe":
                path.unlink()
                os.mkfifo(path)
            cases.append((name, kind, path))
    for kind, name in CASES:
        place = folder / f"{kind.name}, {name}"
        place.mkdir()
        cases.append((name, kind, kind.put(place, BOMBS[Path(kind.file).suffix][name]())))
    for name, kind, path in cases:
        if name == "whole":
            kind.read(path)  # whatever it loads and compiles is there
    most = held() + ROOM_BYTES
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    for name, kind, path in cases:
        try:
            kind.read(path)
            said = "read"
        except InputError as error:
            said = f"InputError: {error.got[:60]}"
        print(f"{kind.name}, {name}: {said}", flush=True)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("bounds")
    program = "from pathlib import Path; import sys; from tests.whole.hostile.test_bounds import try_all; "
    done = subprocess.run(
        [sys.executable, "-c", program + "try_all(Path(sys.argv[1]))", str(folder)],
        capture_output=True,
        text=True,
        timeout=SECONDS,
        cwd=Path(__file__).parents[3],
    )
    assert done.returncode == 0, done.stderr[-2_000:]
    lines = [line.split(": ", 1) for line in done.stdout.splitlines()]
    return dict(lines)


def not_refused(found: dict[str, str], names: list[str]) -> dict[str, str]:
    """What was said of these, other than a refusal in time.

    Of all in one test: workers that share the tests of this file would each begin the process.
    """
    said = {name: found[name] for name in names}
    return {
        name: one for name, one in said.items() if not one.startswith("InputError: ") or "MemoryError" in one
    }


def test_a_file_without_end_is_refused(found: dict[str, str]) -> None:
    endless = [f"{kind.name}, {name}" for kind in FORMATS for name in ("huge", "pipe")]
    # A database says itself how long it is; the rest is nothing.
    assert not_refused(found, endless) == {"ledger, huge": "read"}


def test_a_bomb_is_refused(found: dict[str, str]) -> None:
    assert not_refused(found, [f"{kind.name}, {name}" for kind, name in CASES]) == {}


def test_a_whole_file_is_read_within_the_same_bounds(found: dict[str, str]) -> None:
    assert {said for case, said in found.items() if case.endswith(", whole")} == {"read"}
