#!/usr/bin/env python3
"""Install the newest wheel of dist/ in an empty folder, as a user does, and take every first step.

    .ci/installed.py [PYTHON...|--newest]              ("make installed" makes the wheel before)

PYTHON is an interpreter; without one, those of VERSIONS, on the path or below ~/.pyenv, or the newest of
them.  One that this machine lacks is said.  Where there is no PyBullet the kinematic world runs.  Ends with 1
if any step does not end as it should; what steps printed is shown of those only.
"""

import os
import platform
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

VERSIONS = ("3.11", "3.12", "3.13")
AS_EXPECTED, FOUND = 0, 1
OTHERS = 20  # functions that a step may call with other types than "warm" does
PLAN = """
plan: first steps
avoider: mc-dropout
world: kinematic
strata:
  - stratum: seen
    space: "shipped:nominal"
    runs: 20
claims:
  - claim: TCP speed never above 250 mm/s
    violated in at most: 50 %
"""


def interpreter(version: str) -> str | None:
    """Where Python of ``version`` is, if it starts."""
    installs = Path.home().glob(f".pyenv/versions/{version}.*/bin/python3")
    for candidate in (f"python{version}", *map(str, installs)):
        try:
            if subprocess.run([candidate, "-c", "import venv"], capture_output=True).returncode == 0:
                return candidate
        except OSError:
            continue
    return None


def first_steps(pybullet: bool) -> Iterator[tuple[str, int]]:
    """Each command after ``pip install``, with its exit code; the first that runs compiles for the others."""
    run, test = ("", "") if pybullet else (" --world kinematic", " --safety-world kinematic")
    yield "python -m pip check", AS_EXPECTED
    yield "safety-harness --help", AS_EXPECTED
    yield "safety-harness validate shipped:hand-visits-and-leaves", AS_EXPECTED
    yield "safety-harness run shipped:hand-visits-and-leaves --out run" + run, AS_EXPECTED
    yield "safety-harness copy shipped:hand-visits-and-leaves .", AS_EXPECTED
    yield "python -m pytest -q -p no:cacheprovider hand-visits-and-leaves.yaml" + test, AS_EXPECTED
    # Of the kinematic world nothing is shown without doubt.
    yield "safety-harness certify plan.yaml --workers 1 --out certified", FOUND
    yield "safety-harness verify certified", AS_EXPECTED
    yield "safety-harness evaluate mc-dropout --questions 20 --search 0 --out evaluated", AS_EXPECTED
    # Eight runs do not find what the space says is violated.
    yield "safety-harness fuzz shipped:unseen-both --budget 8 --out fuzzed", FOUND
    yield "safety-harness docs --where", AS_EXPECTED


def installed(python: str, wheel: Path) -> bool:
    """Whether every step with one interpreter ended as it should; says each with its seconds."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "plan.yaml").write_text(PLAN)
        environment = {
            "PATH": f"{folder / 'venv' / 'bin'}:/usr/bin:/bin",
            "HOME": name,
            "SAFETY_HARNESS_CACHE": str(folder / "cache"),
        } | {key: value for key, value in os.environ.items() if key.startswith(("PIP_", "XDG_CONFIG"))}

        def ends_with(step: str, code: int = AS_EXPECTED) -> bool:
            began = time.monotonic()
            done = subprocess.run(step.split(), cwd=folder, env=environment, capture_output=True, text=True)
            as_it_should = done.returncode == code
            print(f"{python}: {step}: {done.returncode}, {time.monotonic() - began:.0f} s", flush=True)
            if not as_it_should:
                print(f"expected {code}\n{done.stdout}{done.stderr}", flush=True)
            return as_it_should

        subprocess.run([python, "-m", "venv", "venv"], cwd=folder, check=True)
        # The versions that the wheel's machine code is of; "make newest" tries the newest.
        lock = f"--constraint {Path('requirements.lock').resolve()}"
        install = f"python -m pip install -q --no-compile --disable-pip-version-check {lock} {wheel} pytest"
        if not ends_with(install):
            return False
        has_it = ["python", "-c", "import pybullet"]
        pybullet = subprocess.run(has_it, cwd=folder, env=environment, capture_output=True).returncode == 0
        megabytes = sum(file.lstat().st_size for file in (folder / "venv").rglob("*") if file.is_file()) / 1e6
        print(f"{python}: {'with' if pybullet else 'no'} PyBullet, {megabytes:.0f} MB", flush=True)
        good = [ends_with(step, code) for step, code in first_steps(pybullet)]
        return all(good) and hardly_compiled(python, wheel, folder)


def hardly_compiled(python: str, wheel: Path, folder: Path) -> bool:
    """Whether the wheel has code for this Python, and the steps compiled few functions; says how many."""
    tag = subprocess.check_output(
        [python, "-c", "import sys; print(sys.implementation.cache_tag)"], text=True
    )
    code = f"-{tag.strip()}/"
    with zipfile.ZipFile(wheel) as archive:
        brought = {Path(name).name for name in archive.namelist() if code in name}
    compiled = {file.name for file in (folder / "cache").rglob("*.nbi")}
    print(f"{python}: {len(compiled)} functions compiled, the wheel has {len(brought)} files", flush=True)
    if platform.machine() != "x86_64":  # for which no wheel brings code
        return True
    return bool(brought) and len(compiled) <= OTHERS


def main(pythons: list[str]) -> int:
    """Two interpreters at a time."""
    wheels = Path("dist").glob("hand_safety_harness-*.whl")
    wheel = max(wheels, key=lambda file: file.stat().st_mtime).resolve()
    if not pythons or pythons == ["--newest"]:
        found = {version: interpreter(version) for version in VERSIONS}
        for version in (version for version, python in found.items() if python is None):
            print(f"Python {version} is not on this machine: the wheel was not installed with it")
        pythons = [python for python in found.values() if python is not None][-len(pythons) :]
    with ThreadPoolExecutor(2) as pool:
        good = list(pool.map(lambda python: installed(python, wheel), pythons))
    return 0 if good and all(good) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
