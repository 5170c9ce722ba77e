"""A program gives the same results on machines that environment variables pretend.

Variants of numba's code are compiled anew, which takes minutes.  No emulator of another instruction set is
used: aarch64 is not shown.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

PROGRAM = Path(__file__).with_name("results_here.py")
WITHOUT_FMA = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA"}
PLAIN_NUMPY = {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"}
MACHINES: dict[str, dict[str, str]] = {
    "matrix kernels of Intel servers": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "matrix kernels of Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "matrix kernels of Zen": {"OPENBLAS_CORETYPE": "Zen"},
    "numpy for AVX2": {"NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR"},
    "numpy for SSE4": PLAIN_NUMPY,
    "C library without FMA": WITHOUT_FMA,
    "code for any x86-64": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "all of an old machine": {"OPENBLAS_CORETYPE": "Nehalem", **PLAIN_NUMPY, **WITHOUT_FMA},
}


def results(machine: dict[str, str], *arguments: str) -> Any:
    environment = {
        **os.environ,
        **machine,
        "PYTHONWARNINGS": "ignore",
    }  # numpy warns of features that it lacks
    done = subprocess.run(
        [sys.executable, PROGRAM, *arguments], env=environment, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def here() -> Any:
    return results({}, "--quick")


def test_an_old_machine_gives_the_same_results(here: Any) -> None:
    """Everything at once; ``test_each_machine_gives_the_same_results`` names what differs."""
    assert results(MACHINES["all of an old machine"], "--quick") == here


@pytest.mark.long
@pytest.mark.parametrize("machine", MACHINES)
def test_each_machine_gives_the_same_results(machine: str, all_here: Any) -> None:
    found = results(MACHINES[machine])
    assert {name for name in all_here if found[name] != all_here[name]} == set()


@pytest.fixture(scope="module")
def all_here() -> Any:
    return results({})
