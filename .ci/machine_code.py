#!/usr/bin/env python3
"""Compile the kernels for any x86-64 processor, into machine_code/, which the build copies into the wheel.

    .ci/machine_code.py [VERSION...]       (of Python; without one those of installed.py)

Versions of numba and numpy are those of requirements.lock.  The user of another one compiles.  A Python that
this machine lacks is said.
"""

import os
import platform
import shutil
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from installed import VERSIONS, interpreter

FOLDER = Path("machine_code")
UV = (".venv-uv/bin/python", ".ci/uv.py")  # which the Makefile installs


def compile_for(version: str) -> bool:
    """Compile in an environment of its own, and return whether this machine has the Python of ``version``."""
    python = interpreter(version)
    if python is None:
        print(f"Python {version} is not on this machine: its users compile")
        return False
    venv, cache = Path(f".venv-code-{version}"), Path("build", f"code-{version}")
    own = str(venv.absolute() / "bin" / "python")
    subprocess.run([*UV, "venv", "--quiet", "--clear", "--python", python, venv], check=True)
    needed = tomllib.loads(Path("pyproject.toml").read_text("utf-8"))["project"]["dependencies"]
    install = ["pip", "install", "--quiet", "--python", own, "--constraint", "requirements.lock"]
    subprocess.run([*UV, *install, *needed], check=True)
    target = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "SAFETY_HARNESS_CACHE": str(cache)}
    subprocess.run([own, "-m", "safety_harness", "warm"], check=True, env=os.environ | target)
    unfinished = shutil.ignore_patterns("*.lock", "*.tmp.*")  # of a second process that was ended
    for folder in (cache / "safety_harness").iterdir():
        if any(folder.glob("*.nbi")):
            shutil.copytree(folder, FOLDER / folder.name, dirs_exist_ok=True, ignore=unfinished)
    return True


def main(versions: list[str]) -> int:
    """Two Pythons at a time; none where the wheel would bring code for another kind of processor."""
    shutil.rmtree(FOLDER, ignore_errors=True)
    if platform.machine() != "x86_64" or sys.platform != "linux":
        print("machine code is made on Linux and x86-64 alone: users of this wheel compile")
        return 0
    with ThreadPoolExecutor(2) as pool:
        return 0 if any(list(pool.map(compile_for, versions or VERSIONS))) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
