from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from base64 import urlsafe_b64encode
from hashlib import sha256
from pathlib import Path

import pytest

from safety_harness.base.distribution import DISTRIBUTION
from safety_harness.base.machine_code import FOLDER, recorded_hashes

ROOT = Path(__file__).parents[2]
KERNEL = """
from safety_harness.base.compiled import compiled


@compiled
def root_of_sum(a, b):
    return (a * b + a) ** 0.5
"""
ASK = """
import json, sys
sys.path[:0] = sys.argv[1:]
from safety_harness.base.compiled import compilation, _progress, code_in_use
from safety_harness.kernel import root_of_sum
value = root_of_sum(2.0, 3.0)
print(json.dumps([value.hex(), compilation().seconds > 0.0, _progress.installed, code_in_use()]))
"""


def write_record(site: Path) -> None:
    """Write what an installer notes: a hash for each file of the package."""
    lines = []
    for file in sorted(site.rglob("*")):
        if file.is_file() and "dist-info" not in file.parts[-2]:
            digest = urlsafe_b64encode(sha256(file.read_bytes()).digest()).decode().rstrip("=")
            lines.append(f"{file.relative_to(site).as_posix()},sha256={digest},{file.stat().st_size}")
    info = site / f"{DISTRIBUTION.replace('-', '_')}-9.9.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {DISTRIBUTION}\nVersion: 9.9\n")
    (info / "RECORD").write_text("\n".join(lines) + "\n")


def ask(site: Path, cache: Path, **variables: str) -> tuple[list[object], str]:
    """Run the kernel in a process of its own; return what it printed, and its standard error."""
    environment = {key: one for key, one in os.environ.items() if not key.startswith(("NUMBA_", "PYTHON"))}
    done = subprocess.run(
        [sys.executable, "-c", ASK, str(site)],
        capture_output=True,
        text=True,
        check=True,
        cwd=site.parent,
        env=environment | {"SAFETY_HARNESS_CACHE": str(cache), **variables},
    )
    found: list[object] = json.loads(done.stdout)
    return found, done.stderr


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An installation of ``base`` and one kernel, with its machine code for any x86-64."""
    folder = tmp_path_factory.mktemp("installation")
    package = folder / "site" / "safety_harness"
    shutil.copytree(ROOT / "safety_harness" / "base", package / "base")
    (package / "__init__.py").touch()
    (package / "kernel.py").write_text(KERNEL)
    (package / "cell" / "controller").mkdir(parents=True)
    (package / "cell" / "controller" / "stack.py").write_text(KERNEL)
    generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    (_, compiled_it, installed, _), _ = ask(package.parent, folder / "generic", **generic)
    assert (compiled_it, installed) == (True, 0)
    shutil.copytree(folder / "generic" / "safety_harness", package / FOLDER)
    write_record(package.parent)
    return package.parent


@pytest.fixture
def site(built: Path, tmp_path: Path) -> Path:
    """A copy to change."""
    return Path(shutil.copytree(built, tmp_path / "site"))


def code_files(site: Path, suffix: str) -> list[Path]:
    return sorted((site / "safety_harness" / FOLDER).rglob(f"*{suffix}"))


def test_installed_machine_code_gives_the_same_bits_and_the_hosts_own_comes_first(
    site: Path, tmp_path: Path
) -> None:
    (value, compiled_it, installed, _), said = ask(site, tmp_path / "cache")
    assert (compiled_it, installed, said) == (False, 1, "")
    code = shutil.move(site / "safety_harness" / FOLDER, tmp_path / "aside")
    (anew, compiled_it, installed, words), _ = ask(site, tmp_path / "cache")
    assert (anew, compiled_it, installed, words) == (value, True, 0, "machine code compiled here")
    shutil.move(code, site / "safety_harness" / FOLDER)
    (_, compiled_it, installed, _), _ = ask(site, tmp_path / "cache")
    assert (compiled_it, installed) == (False, 0)


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
def test_changed_machine_code_is_compiled_anew_and_named(suffix: str, site: Path, tmp_path: Path) -> None:
    (file,) = code_files(site, suffix)
    file.write_bytes(file.read_bytes() + b"x")
    (_, compiled_it, installed, _), said = ask(site, tmp_path / "cache")
    assert (compiled_it, installed) == (True, 0)
    assert f"{file.name} is not as it was installed" in said


def test_machine_code_that_no_record_names_is_not_read(site: Path, tmp_path: Path) -> None:
    marker = tmp_path / "executed"
    (index,) = code_files(site, ".nbi")
    index.write_bytes(b"cos\nmkdir\n(V" + str(marker).encode() + b"\ntR.")  # a pickle that makes a folder
    for record in site.glob("*.dist-info/RECORD"):
        record.write_text("")
    (_, compiled_it, _, _), _ = ask(site, tmp_path / "cache")
    assert compiled_it
    assert not marker.exists()


def test_a_changed_pickle_is_not_read(site: Path, tmp_path: Path) -> None:
    marker = tmp_path / "executed"
    (index,) = code_files(site, ".nbi")
    index.write_bytes(b"cos\nmkdir\n(V" + str(marker).encode() + b"\ntR.")
    ask(site, tmp_path / "cache")
    assert not marker.exists()


def test_machine_code_of_another_source_is_not_used(site: Path, tmp_path: Path) -> None:
    kernel = site / "safety_harness" / "kernel.py"
    kernel.write_text(KERNEL.replace("a * b + a", "a * b - a"))
    (value, compiled_it, installed, _), _ = ask(site, tmp_path / "cache")
    assert (float.fromhex(str(value)), compiled_it, installed) == (2.0, True, 0)


def test_a_checkout_has_no_recorded_machine_code() -> None:
    assert recorded_hashes(ROOT / "safety_harness") == {}
