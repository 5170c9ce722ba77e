"""Define the hooks of the pytest plug-in, which import heavy modules only when they first need them.

Most projects never need these modules.  The plug-in does nothing in a session that has neither a scenario
file nor a test that uses ``safety_harness.testing``.
"""

from __future__ import annotations

import io
import os
import random
import re
import sys
from collections.abc import Generator
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from safety_harness.base.compiling import CompilationLine, watchers
from safety_harness.base.exceptions import InputError, Place, SafetyHarnessError
from safety_harness.report.compile_ahead import SecondProcess
from safety_harness.scenario.kinds import SUFFIXES, is_log
from safety_harness.testing.plugin.explained import JUDGES_ITSELF, TEST, explained
from safety_harness.testing.session import (
    FAILURES,
    PROFILES,
    QUICK,
    Session,
    begin,
    session,
)

if TYPE_CHECKING:
    from safety_harness.testing.plugin.collecting import LogFile, ScenarioFile
    from safety_harness.testing.simulating import Simulate


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options and ini settings of the plug-in."""
    names = [profile.name for profile in PROFILES]
    sizes = ", ".join(f"{profile.name} {profile.examples}" for profile in PROFILES)
    group = parser.getgroup("safety-harness", "safety properties of a hand-avoiding robot arm")
    group.addoption(
        "--avoider",
        metavar="AVOIDER",
        help="The avoider instead of the files': mc-dropout, 'opposite pose', FILE.py:NAME, FILE.onnx, ...",
    )
    group.addoption(
        "--safety-against",
        metavar="AVOIDER",
        help="A reference: tests fail only for violations that it does not have in the same scenario.",
    )
    group.addoption(
        "--safety-world",
        metavar="WORLD",
        help="PyBullet, MuJoCo or kinematic; in place of safety_world.",
    )
    group.addoption("--safety-profile", choices=names, help=f"Scenarios that a test draws: {sizes}.")
    group.addoption(
        "--safety-derandomize", action="store_true", help="Draw the same scenarios in every session."
    )
    group.addoption("--safety-report", metavar="FILE", help="Write an HTML report, and JSON beside it.")
    parser.addini("safety_profile", f"one of {', '.join(names)}", default=QUICK.name)
    parser.addini(
        "safety_world", "PyBullet or kinematic; without it PyBullet, if it is installed", default=""
    )
    parser.addini(
        "safety_derandomize", "draw the same scenarios in every session", type="bool", default=False
    )
    parser.addini(
        "safety_scenarios",
        "patterns of the scenario files, from pytest's root; without it they are known by their keys",
        type="args",
        default=None,
    )
    parser.addini(
        "safety_failures", "folder for the scenarios of failures, from pytest's root", default=str(FAILURES)
    )


def pytest_configure(config: pytest.Config) -> None:
    """Begin a session, and end it at once if the avoider cannot be used."""
    config.addinivalue_line("markers", f"{JUDGES_ITSELF}: a test that looks at runs without assert_holds")
    name = config.getoption("safety_profile") or config.getini("safety_profile")
    profiles = {profile.name: profile for profile in PROFILES}
    if name not in profiles:
        raise pytest.UsageError(f"safety_profile: expected one of {', '.join(profiles)}; got {name!r}")
    report = config.getoption("safety_report")  # relative to the folder in which pytest was started
    new = Session(
        root=config.rootpath,
        profile=profiles[name],
        derandomize=config.getoption("safety_derandomize") or config.getini("safety_derandomize"),
        seed=_seed(config),
        avoider=config.getoption("avoider"),
        against=config.getoption("safety_against"),
        world=config.getoption("safety_world") or config.getini("safety_world"),
        failures=config.rootpath / config.getini("safety_failures"),
        report=None if report is None else config.invocation_params.dir / report,
    )
    if config.getoption("safety_world"):
        _refuse_unknown_world(new.world)
    config.add_cleanup(partial(_end, begin(new)))
    if _is_worker(config):
        config.workeroutput["safety_ignored"] = new.ignored  # type: ignore[attr-defined]
    else:
        from safety_harness.testing.plugin.ending import Ending

        config.pluginmanager.register(Ending(config), "safety-harness-ending")
        second = SecondProcess()
        for watcher in (second, CompilationLine(_PastCapture(config), second.finished_part)):
            watchers.append(watcher)
            config.add_cleanup(partial(watchers.remove, watcher))
        if not config.option.help:
            _refuse_unusable_avoiders(make=False)
            _refuse_idle_patterns(config)


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Pass the same seed to every worker of xdist."""
    node.workerinput["safety_seed"] = session().seed


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> LogFile | ScenarioFile | None:
    """Collect the scenario files, spaces, suites and logs that match ``safety_scenarios``.

    Without that setting, the plug-in collects the files that the harness recognises. It also collects a file
    that the user lists on the command line if the file has a title of the harness, so that mistakes in it are
    reported.
    """
    patterns = parent.config.getini("safety_scenarios")
    if patterns is None and file_path.suffix.lower() not in SUFFIXES:
        return None  # before any import, because most files belong to other projects
    from safety_harness.scenario.ours import is_ours, is_titled

    if patterns is not None:
        name = os.path.relpath(file_path, parent.config.rootpath)
        ours = any(fnmatch(name, pattern) for pattern in patterns)
    else:
        ours = is_log(file_path) or is_ours(file_path)
        if not ours and is_titled(file_path):
            ours = parent.session.isinitpath(file_path)
            session().ignored += [os.path.relpath(file_path)] * (not ours)
    if not ours:
        return None
    from safety_harness.testing.plugin.collecting import LogFile, ScenarioFile

    kind = LogFile if is_log(file_path) else ScenarioFile
    return kind.from_parent(parent, path=file_path)


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> None:
    """Refuse an ``--avoider`` that cannot be created, before the first test runs.

    This check is done here and not during the collection, because collection must not execute an avoider.
    """
    config = session.config
    elsewhere = config.pluginmanager.hasplugin("dsession")  # xdist's workers run the tests
    if config.option.collectonly or _is_worker(config) or not (session.testscollected or elsewhere):
        return
    _refuse_unusable_avoiders(make=True)


@pytest.fixture(scope="session")
def simulate() -> Simulate:
    """Return a function that runs a scenario and returns the trace of its run."""
    from safety_harness.testing.simulating import simulate as shared

    return shared


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, Any, Any]:
    """Watch a test while it runs, if it may judge runs."""
    if "safety_harness.testing.asserting" not in sys.modules:  # in this case no test has judged a run
        return (yield)
    from safety_harness.testing.plugin.running import watch

    with watch(item):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the judgements to the test report, which carries them to JUnit and from a worker to the session."""
    report = yield
    test = item.stash.get(TEST, None)
    if test is not None and report.when == "call":
        from safety_harness.testing.plugin.running import complete

        complete(report, item, call, test)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Report a mistake in a scenario file or in a test's request without traceback frames of the harness."""
    report = yield
    call = getattr(report, "call", None)
    if report.failed and call is not None and isinstance(call.excinfo.value, SafetyHarnessError):
        report.longrepr = explained(call.excinfo.value)
    return report


class _PastCapture(io.StringIO):
    """A stream that writes to the terminal during a test, even while the output of the test is captured."""

    def __init__(self, config: pytest.Config) -> None:
        super().__init__()
        self._plugins = config.pluginmanager

    def write(self, text: str) -> int:
        """Write ``text`` as a whole line."""
        capture, reporter = map(self._plugins.getplugin, ("capturemanager", "terminalreporter"))
        if capture and reporter:
            streams = sys.stdin, sys.stdout, sys.stderr  # the test may have replaced them
            with capture.global_and_fixture_disabled():
                reporter.write_line(text.rstrip("\n"))
            sys.stdin, sys.stdout, sys.stderr = streams
        return len(text)


def _end(previous: Session) -> None:
    begin(previous)


def _is_worker(config: pytest.Config) -> bool:
    return hasattr(config, "workerinput")


def _seed(config: pytest.Config) -> int:
    """Return the seed of ``--hypothesis-seed`` or a new seed.

    A worker of xdist uses the seed of its session.
    """
    if _is_worker(config):
        return int(config.workerinput["safety_seed"])  # type: ignore[attr-defined]
    option = config.getoption("--hypothesis-seed", default=None)
    if option is not None and option.isdigit():
        return int(option)
    return random.SystemRandom().randrange(2**32)


def _refuse_idle_patterns(config: pytest.Config) -> None:
    """Raise UsageError for a pattern of ``safety_scenarios`` that matches no file where pytest looks."""
    of_ini = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    for pattern in config.getini("safety_scenarios") or ():
        # Walk only below the pattern's literal beginning, because a project may have many files.
        literal = re.split(r"[*?[]", pattern)[0].rpartition("/")[0]
        starts = [config.rootpath / literal] if not of_ini else map(Path, config.args)
        names = (Path(at, file) for start in starts for at, _, files in os.walk(start) for file in files)
        if not any(fnmatch(os.path.relpath(name, config.rootpath), pattern) for name in names):
            where = f"below {' '.join(config.args)}, of testpaths" if of_ini else f"below {config.rootpath}"
            raise pytest.UsageError(
                f"safety_scenarios: expected a pattern of scenario files; got {pattern!r}, no file {where}"
            )


def _refuse_unusable_avoiders(*, make: bool) -> None:
    now = session()
    for reference, option in ((now.avoider, "--avoider"), (now.against, "--safety-against")):
        if reference is not None:
            refuse_unusable_avoider(reference, option, make=make)
    if now.against is not None:
        from safety_harness.admission.comparison import refuse_itself

        try:
            refuse_itself(now.avoider, now.against, "--safety-against")
        except InputError as error:
            raise pytest.UsageError(explained(error)) from None


def _refuse_unknown_world(label: str) -> None:
    from safety_harness.cell.simulation.worlds import world_named

    try:
        world_named(label, "--safety-world")
    except InputError as error:
        raise pytest.UsageError(explained(error)) from None


def refuse_unusable_avoider(reference: str, option: str, *, make: bool) -> None:
    """Raise UsageError for a missing or invalid avoider.

    The avoider's file is executed only if ``make`` is true.
    """
    from safety_harness.admission.avoiders import refuse_unusable, resolve_avoider, scenario_of_avoider

    try:
        refuse = resolve_avoider if make else refuse_unusable
        refuse(scenario_of_avoider(reference), Place(field=option))
    except InputError as error:
        raise pytest.UsageError(explained(error)) from None
