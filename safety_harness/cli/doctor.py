"""Define ``safety-harness doctor``, which reports missing and faulty parts of the installation."""

from __future__ import annotations

import os
import platform
import re
import sys
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from importlib import import_module, metadata
from importlib.util import find_spec
from operator import eq, ge, gt, le, lt, ne

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge, run_kinematic
from safety_harness.base.compiled import (
    PACKAGE,
    cache_folder,
    cache_problem,
    cache_root,
    code_in_use,
    installed_folder,
)
from safety_harness.base.distribution import DISTRIBUTION, foreign_files
from safety_harness.base.extras import EXTRAS
from safety_harness.base.interpreted import without_compiling
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.tally import table
from safety_harness.cli.console import AS_EXPECTED, DIFFERS, columns_of, document, result
from safety_harness.cli.warm import SHORT_RUN, machine_code_bytes, megabytes
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.read import parse_scenario
from safety_harness.trace.provenance import shared_modules

_COMPARED = {"==": eq, "!=": ne, ">=": ge, "<=": le, ">": gt, "<": lt}
_REQUIREMENT = re.compile(r"([\w.-]+)(?:\[.*?\])?\s*\(?([^;)]*)\)?\s*(?:;\s*(.*))?")


class State(StrEnum):
    """The outcome of one check of the installation."""

    OK = "ok"
    MISSING = "missing"
    PROBLEM = "problem"


@dataclass(frozen=True)
class Examined:
    """The result of one check of the installation.

    ``what`` is the checked part, ``words`` describes the finding, and ``needed`` states whether every run
    needs the part.
    """

    what: str
    state: State
    words: str
    needed: bool = True


def examine() -> int:
    """Check the installation, print the results, and return the exit code."""
    checks = [*_machine(), *_required(), *_optional(), *_clashes(), _self_check()]
    problems = [check for check in checks if check.state is State.PROBLEM and check.needed]
    document(checks=[asdict(check) for check in checks], good=not problems)
    rows = [(check.state.value, check.what, check.words) for check in checks]
    result(*table(("state", "what", "found"), rows, columns_of(sys.stdout)))
    return DIFFERS if problems else AS_EXPECTED


def _machine() -> Iterator[Examined]:
    """Yield the checks of the machine, of Python, and of the folder that caches machine code."""
    yield Examined("machine", State.OK, f"{platform.platform()}, {os.cpu_count()} processors")
    python, wanted = platform.python_version(), metadata.metadata(DISTRIBUTION)["Requires-Python"] or ""
    good = fits(python, wanted)
    text = python if good else f"{python}, which this package is not made for: {wanted}"
    yield Examined("Python", State.OK if good else State.PROBLEM, text)
    problem = cache_problem(cache_root())
    stack = PACKAGE / "cell" / "controller" / "stack.py"
    warm = installed_folder(stack).is_dir() or any(cache_folder(stack).rglob("*.nbc"))
    text = "cold: the first run compiles, for up to a minute; safety-harness warm does it now"
    text = f"{code_in_use()}{', read-only' if problem else ''}" if warm else problem or text
    text = f"{cache_root()}, {megabytes(machine_code_bytes())}, {text}"
    yield Examined("machine code", State.PROBLEM if problem and not warm else State.OK, text)


def _required() -> Iterator[Examined]:
    """Yield a check for each required package.

    The package must be installed, have a version in the required range, and be importable.
    """
    modules: dict[str, list[str]] = {}
    for module, names in metadata.packages_distributions().items():
        for name in names:
            modules.setdefault(name.lower(), []).append(module)
    for name, wanted in required().items():
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            yield Examined(name, State.PROBLEM, f"not installed; pip install '{name}{wanted}'")
            continue
        yield _installed(name, version, wanted, sorted(modules.get(name.lower(), [])))


def _installed(name: str, version: str, wanted: str, modules: list[str]) -> Examined:
    if not fits(version, wanted):
        return Examined(name, State.PROBLEM, f"{version}, which is not {wanted}")
    module = name if name in modules else next((item for item in modules if not item.startswith("_")), None)
    module = "safety_harness.cell.simulation.engine" if name == "pybullet" else module  # a quiet import
    try:
        if module is not None:
            with warnings.catch_warnings(action="ignore"):
                import_module(module)
    except Exception as error:  # a broken package may raise anything
        return Examined(name, State.PROBLEM, f"{version} cannot be imported: {type(error).__name__}: {error}")
    return Examined(name, State.OK, version)


def _optional() -> Iterator[Examined]:
    needed = required()
    for extra in EXTRAS:
        module = extra.modules[0]
        name = extra.package or module
        if name in needed:
            continue
        if find_spec(module) is None:
            yield Examined(name, State.MISSING, f"for {extra.use}", needed=False)
        else:
            yield Examined(name, State.OK, _version(name), needed=False)


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "by another package"  # such as opencv-python in place of opencv-python-headless


def _clashes() -> Iterator[Examined]:
    """Yield the packages that share a module.

    In this case, the version of a package does not show which code runs.
    """
    if foreign := foreign_files():
        yield Examined("package safety_harness", State.PROBLEM, foreign)
    needed = required()
    for module, packages in shared_modules().items():
        text = f"{' and '.join(packages)} own it; uninstall all of them, install one"
        base = any(package.split()[0] in needed for package in packages)
        yield Examined(f"module {module}", State.PROBLEM, text, needed=base)


def _self_check() -> Examined:
    """Simulate a short kinematic run with a hand, and check a claim that must hold.

    The check runs without compilation.
    """
    try:
        evaluation = without_compiling(_short_run)
    except Exception as error:  # the check looks for any error of the installation
        return Examined("self-check", State.PROBLEM, f"{type(error).__name__}: {error}")
    good = evaluation.verdict is Verdict.HOLDS
    text = f"a short kinematic run: {evaluation.sentence}: {evaluation.verdict.value}"
    return Examined("self-check", State.OK if good else State.PROBLEM, text)


def _short_run() -> Evaluation:
    scenario = replace(parse_scenario(SHORT_RUN), duration_s=0.2)
    (evaluation,) = judge(run_kinematic(admit(scenario)))
    return evaluation


def required() -> dict[str, str]:
    """Return the packages that every installation needs with this version of Python.

    The values are their version ranges.
    """
    ranges: dict[str, str] = {}
    for text in metadata.requires(DISTRIBUTION) or ():
        match = _REQUIREMENT.match(text)
        assert match is not None, text  # the package's own requirement, which has this form
        name, wanted, marker = match[1], match[2].strip(), match[3] or ""
        python = re.search(r"python_version\s*([<>=!]+)\s*['\"]([\d.]+)['\"]", marker)
        if "extra" in marker or (python and not fits(platform.python_version(), python[1] + python[2])):
            continue
        ranges[name] = wanted
    return ranges


def fits(version: str, wanted: str) -> bool:
    """Return whether ``version`` lies in a range such as ``>=2.0,<3``, whose limits contain only numbers.

    A version is compared with a limit only to the limit's number of digits, so 2.4.6 satisfies ``==2.4`` but
    not ``>2.4``.
    """
    for part in filter(None, (limit_text.strip() for limit_text in wanted.split(","))):
        match = re.fullmatch(r"(==|!=|>=|<=|>|<)\s*([\d.]+)(?:\.\*)?", part)
        if match is None:
            return False
        limit = [int(number) for number in match[2].split(".")]
        # Compare as many numbers as the limit has, so that 2.4.6 satisfies ==2.4.
        have = [int(number) for number in re.findall(r"\d+", version.partition("+")[0])]
        if not _COMPARED[match[1]]((have + [0] * len(limit))[: len(limit)], limit):
            return False
    return True
