"""Results come from operations whose bits IEEE 754 fixes.

The C library, matrix kernels and numpy's own exponentials differ between processors.
``safety_harness/base/elementary.py`` and its neighbours take their place.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import safety_harness

PACKAGE = Path(safety_harness.__file__).parent
# What influences a trace, a verdict, a draw or a bound.
ROOMS = ("base", "scenario", "trace", "seams", "cell", "space", "claims", "admission", "search")
WINGS = ("assurance", "selftest")
# The C library's, and numpy's, which picks code by the processor.
TRANSCENDENTAL = {
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "arcsin", "arccos", "arctan", "arctan2",
    "sinh", "cosh", "tanh", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "power",
    "float_power", "hypot", "cbrt", "erf", "erfc", "gamma", "lgamma", "dist", "logaddexp", "angle",
    "geomspace", "logspace",
}  # fmt: skip
# Sums in an order of the matrix kernel's own.
SUMS = {
    "dot", "vdot", "inner", "matmul", "tensordot", "einsum", "multi_dot", "convolve", "correlate",
    "corrcoef", "cov",
}  # fmt: skip
LINALG = {
    "solve", "inv", "pinv", "svd", "eig", "eigh", "eigvals", "eigvalsh", "lstsq", "det", "qr",
    "cholesky", "cond", "matrix_rank", "slogdet",
}  # fmt: skip
DRAWS = {
    "normal", "standard_normal", "lognormal", "exponential", "standard_exponential", "gamma",
    "beta", "chisquare",
}  # fmt: skip
# File: names that it may use, and why.
EXCEPTIONS = {
    "base/normals.py": (
        {"standard_normal"},
        "takes the tails, where numpy calls the C library, from elsewhere",
    ),
    "base/proportions.py": ({"scipy"}, "only a guide to a bound; test_special has others"),
    "search/sampling.py": ({"scipy"}, "Sobol's sequence: whole numbers, and one product with a power of two"),
    "claims/properties/shield_theorem.py": (
        {"scipy"},
        "weights are a witness; their error is summed here and held against a tolerance",
    ),
    "cell/avoidance/onnx_file.py": (
        {"onnxruntime"},
        "a stranger's network: the runtime has kernels of its own",
    ),
    "extensions/assurance/statistics/planning.py": ({"scipy"}, "numbers of runs before a plan: no result"),
    "space/strategy.py": ({"**"}, "a power of a fraction is exact"),
    "extensions/assurance/pages/history.py": ({"scipy"}, "a word about a trend on a page"),
    "extensions/assurance/certification/results.py": ({"geomspace"}, "the points of a drawing"),
    "extensions/assurance/certification/result_tables.py": ({"log10", "**"}, "digits that a page shows"),
    "extensions/assurance/certification/verdicts.py": ({"log10"}, "digits that a page shows"),
    "extensions/assurance/certification/figures.py": ({"log10", "**"}, "the axis of a drawing"),
}
PHYSICS = ("cell/simulation/pybullet_world.py", "cell/simulation/cell.py")  # compared with a tolerance


def files() -> Iterator[Path]:
    rooms = [PACKAGE / room for room in ROOMS] + [PACKAGE / "extensions" / wing for wing in WINGS]
    return (file for room in rooms for file in sorted(room.rglob("*.py")) if "shipped" not in file.parts)


def used(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and name of each use of what the rules refuse."""
    compiled = {
        id(inner)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        and any(
            ast.unparse(one) in {"compiled", "inlined", "njit_no_nrt", "arithmetic"}
            for one in function.decorator_list
        )
        for inner in ast.walk(function)
    }
    for node in ast.walk(tree):
        match node:
            case ast.BinOp(op=ast.MatMult()) | ast.AugAssign(op=ast.MatMult()):
                yield node.lineno, "@"
            case ast.BinOp(op=ast.Pow(), left=left, right=right):
                whole = isinstance(right, ast.Constant) and isinstance(right.value, int)
                constant = isinstance(left, ast.Constant) and (
                    isinstance(left.value, int) or left.value == 2.0
                )
                # machine code multiplies for a constant exponent, and so does Python for whole numbers
                if not (
                    constant or (whole and id(node) in compiled) or _of_whole_numbers(left, compiled, node)
                ):
                    yield node.lineno, "**"
            case ast.Attribute(value=ast.Name(id="np" | "math" | "numpy"), attr=name) if (
                name in TRANSCENDENTAL | SUMS
            ):
                yield node.lineno, name
            case ast.Attribute(value=ast.Attribute(attr="linalg"), attr=name) if name in LINALG:
                yield node.lineno, name
            case ast.Call(func=ast.Attribute(attr="norm", value=ast.Attribute(attr="linalg")), keywords=[]):
                yield node.lineno, "norm without an axis"
            case ast.Attribute(attr="dot" | "inv_cdf"):
                yield node.lineno, node.attr
            case ast.Call(func=ast.Attribute(attr=name)) if name in DRAWS:
                yield node.lineno, name
            case ast.ImportFrom(module=str(module), names=names):
                if module.split(".")[0] in {"scipy", "cmath", "cma", "onnxruntime", "torch"}:
                    yield node.lineno, module.split(".")[0]
                if module == "math":
                    yield from ((node.lineno, one.name) for one in names if one.name in TRANSCENDENTAL)
            case ast.Import(names=names):
                for one in names:
                    if one.name.split(".")[0] in {"scipy", "cmath", "cma", "onnxruntime", "torch"}:
                        yield node.lineno, one.name.split(".")[0]


def _of_whole_numbers(left: ast.expr, compiled: set[int], node: ast.AST) -> bool:
    return id(node) in compiled and ast.unparse(left) == "slots + 1"


def test_results_come_from_operations_with_the_same_bits_everywhere() -> None:
    found = []
    for file in files():
        name = file.relative_to(PACKAGE).as_posix()
        allowed = EXCEPTIONS.get(name, (set(), ""))[0]
        found += [
            f"{name}:{line}: {what}"
            for line, what in used(ast.parse(file.read_text()))
            if what not in allowed
        ]
    assert not [place for place in found if not place.startswith(PHYSICS)]


@pytest.mark.parametrize("name", EXCEPTIONS)
def test_every_exception_is_needed(name: str) -> None:
    allowed, reason = EXCEPTIONS[name]
    assert reason
    assert allowed == {what for _, what in used(ast.parse((PACKAGE / name).read_text()))} & allowed


@pytest.mark.parametrize(
    "text",
    [
        "np.sin(x)", "math.exp(x)", "from math import atan2", "a @ b", "a @= b", "np.linalg.norm(x)", "x**2",
        "np.linalg.svd(a)", "np.dot(a, b)", "a.dot(b)", "rng.normal(size=3)", "rng.standard_normal(3)",
        "import scipy",
        "from scipy.special import ndtr", "NormalDist().inv_cdf(p)", "np.einsum('i,i', a, b)", "10.0**x",
    ],
)  # fmt: skip
def test_each_of_these_is_refused(text: str) -> None:
    assert list(used(ast.parse(text)))


@pytest.mark.parametrize(
    "text", ["np.sqrt(x)", "sin(x)", "np.linalg.norm(x, axis=1)", "2.0**-53", "10**9", "(a * b).sum()"]
)
def test_each_of_these_is_arithmetic(text: str) -> None:
    assert not list(used(ast.parse(text)))
