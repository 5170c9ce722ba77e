"""The upright rows of benchmarks/convergence.py, which is loaded by its path: it is no package."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.linalg import expm

from safety_harness.base.settings import ImageSource, InteractionChoice


def load_benchmark() -> ModuleType:
    path = Path(__file__).parents[3] / "benchmarks" / "convergence.py"
    spec = importlib.util.spec_from_file_location("convergence_benchmark", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


convergence = load_benchmark()


few_and_all = pytest.mark.parametrize(
    "starts", [40, pytest.param(convergence.STARTS, marks=pytest.mark.long)], ids=["few", "all"]
)


@few_and_all
@pytest.mark.parametrize("choice", list(InteractionChoice))
def test_from_exact_moments_every_upright_start_converges(choice: InteractionChoice, starts: int) -> None:
    assert convergence.count_row(ImageSource.EXACT, choice, 0.0, starts=starts).succeeded == starts


@few_and_all
def test_from_rasterised_moments_nearly_every_upright_start_converges(starts: int) -> None:
    row = convergence.count_row(ImageSource.RASTER, InteractionChoice.DESIRED, 0.0, starts=starts)
    assert row.succeeded >= 0.99 * starts


@pytest.mark.parametrize("size", [1e-9, 1e-3, 9.9e-3, 1.01e-2, 0.5, 3.0])
def test_the_camera_moves_along_the_matrix_exponential(size: float) -> None:
    rng = np.random.default_rng(1)
    twist = rng.normal(size=6)
    twist[3:] *= size / np.linalg.norm(twist[3:])
    v, (a, b, c) = twist[:3], twist[3:]
    generator = np.array([[0.0, -c, b, v[0]], [c, 0.0, -a, v[1]], [-b, a, 0.0, v[2]], [0.0, 0.0, 0.0, 0.0]])
    pose = expm(np.array([[0, -1, 0.2, 0.1], [1, 0, -0.3, 0.2], [-0.2, 0.3, 0, 0.6], [0, 0, 0, 0]]))
    expected = expm(-0.5 * generator) @ pose
    convergence.move_camera(pose, twist, 0.5)
    np.testing.assert_allclose(pose, expected, atol=1e-10)
