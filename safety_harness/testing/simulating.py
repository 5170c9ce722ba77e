"""Provide the fixture ``simulate``, which runs a scenario and returns the trace of the run."""

from __future__ import annotations

import hashlib
import inspect
import os
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path
from types import FrameType
from weakref import WeakKeyDictionary, WeakSet

from safety_harness.admission.admit import Admitted, Admitter, Checker, admit
from safety_harness.admission.avoiders import command_line_reference, option_of, with_avoider
from safety_harness.admission.comparison import with_reference
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import FlakyAvoiderError, InputError, Place
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.flaky import refuse_flaky
from safety_harness.cell.simulation.simulate import INTERRUPTED
from safety_harness.cell.simulation.worlds import default_world, world_named
from safety_harness.claims.properties.answered import by_default
from safety_harness.claims.properties.tried import TriedParts
from safety_harness.report.decisions import computing_times
from safety_harness.scenario.files import as_path
from safety_harness.scenario.model import RecordedHand, Scenario
from safety_harness.scenario.read import read_scenario
from safety_harness.scenario.write import write_scenario
from safety_harness.seams.contract import UserController
from safety_harness.testing.session import TestRun, session
from safety_harness.trace.overruling import Overruling
from safety_harness.trace.trace import Trace

MOST_TICKS = 100_000  # of all remembered traces together: about a hundred megabytes

_asked_for: WeakKeyDictionary[Trace, Scenario] = WeakKeyDictionary()
_of_objects: WeakSet[Trace] = WeakSet()


def original(trace: Trace) -> Scenario:
    """Return the scenario that the test passed, before ``--avoider`` replaced its avoider."""
    return _asked_for.get(trace, trace.scenario)


def is_of_an_object(trace: Trace) -> bool:
    """Return whether a test passed an avoider or a controller as an object.

    A command cannot contain such an object.
    """
    return trace in _of_objects


def digest_of(scenario: Scenario) -> str:
    """Return a hex digest that is equal for two scenarios that differ at most in their names."""
    text = write_scenario(scenario)
    hands = [hand.motion.sha256 for hand in scenario.hands if isinstance(hand, RecordedHand)]
    parts = [text, *hands, command_line_reference(scenario)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def run_key(trace: Trace) -> str:
    """Return a key for the run that is the same in every process: the system under test and the scenario."""
    return f"{trace.system.tested.name}: {digest_of(trace.scenario)}"


def as_asked(scenario: Scenario) -> Scenario:
    """Return the scenario with the avoider of ``--avoider``, if that option was given."""
    reference = session().avoider
    return scenario if reference is None else with_avoider(scenario, reference)


def avoiders_asked() -> list[tuple[str | None, str]]:
    """Return pairs of an avoider and the name of its option.

    The first pair has the avoider of ``--avoider``, or None. A second pair follows if the session has a
    reference.
    """
    now = session()
    reference = [] if now.against is None else [(now.against, "--safety-against")]
    return [(now.avoider, option_of(now.avoider or "")), *reference]


checker = Checker()  # checks what is collected without executing any user's code
admitter = Admitter()  # shared by all runs, so that an avoider that remembers a run is found flaky


def sought_from(path: Path, caller: FrameType | None) -> Path:
    """Return ``path`` relative to the folder of the calling file, if the file exists there.

    Otherwise return the path relative to pytest's root.
    """
    if path.is_absolute() or caller is None:
        return path
    beside = Path(caller.f_code.co_filename).parent / path
    return Path(os.path.abspath(beside if beside.exists() else session().root / path))


class Simulate:
    """The callable ``simulate(scenario)``.

    Two calls with the same scenario return the same trace. A call runs the scenario in the world of
    ``--safety-world``, or in PyBullet if the option is absent.

    Args:
        scenario: A scenario, or the path of its file.  A relative path is resolved as in ``scenarios``.
        avoider: An avoider that replaces the avoider of ``--avoider`` and of the scenario.
        controller: A controller that drives the arm in place of the visual servo.

    Raises:
        InputError: The scenario is not admissible.
        FlakyAvoiderError: The avoider answers a repeated question of the run differently.

    """

    def __init__(self) -> None:
        self._traces: OrderedDict[str, Trace] = OrderedDict()

    def __repr__(self) -> str:
        return "<simulate>"

    def __call__(
        self,
        scenario: Scenario | str | Path,
        *,
        avoider: Avoider | None = None,
        controller: UserController | None = None,
    ) -> Trace:
        """Run ``scenario`` and return the trace, or return the trace of an earlier run of it."""
        __tracebackhide__ = True
        frame, test = inspect.currentframe(), session().test
        if test is not None:
            test.asked = True
        try:
            if not isinstance(scenario, Scenario):
                path = as_path(scenario, "simulate(scenario)", of_text="parse_scenario")
                scenario = read_scenario(sought_from(path, frame.f_back if frame else None))
            if avoider is not None or controller is not None:
                trace = _run(admit(scenario, avoider=avoider, controller=controller))
                _of_objects.add(trace)
            else:
                trace = self._remembered(as_asked(scenario))
                _asked_for[trace] = scenario
        except (InputError, FlakyAvoiderError) as error:
            raise error.with_traceback(None) from None
        run = run_key(trace)
        if test is None or test.counts:
            session().simulated.add(run)
        if test is None or not test.counts:
            return trace
        if len(trace.decisions):
            test.overruled[run] = Overruling.from_traces([trace])
        test.tried[run] = TriedParts.from_traces(trace)
        if test.fallback is None and by_default(trace) is not None:
            test.fallback = trace
        return trace

    def with_reference(self, trace: Trace) -> Trace:
        """Run the scenario of ``trace`` with the avoider of ``--safety-against``.

        If this run raises an error, the error is not caught.
        """
        reference = session().against
        assert reference is not None
        place = Place(field="--safety-against")
        return self._remembered(with_reference(original(trace), reference, place))

    def _remembered(self, scenario: Scenario) -> Trace:
        test, digest = session().test, digest_of(scenario)
        if test is not None:
            test.simulated.add(digest)
        if digest in self._traces:
            self._traces.move_to_end(digest)
            # The digest ignores the scenario's name, so the remembered trace may have another name.
            return replace(self._traces[digest], scenario=scenario)
        _refuse_more_shrinking(test, digest)
        try:
            trace = _run(admitter.admit(scenario))
        except (InputError, FlakyAvoiderError) as error:
            if test is not None:
                test.refused[digest] = error
            raise
        self._traces[digest] = trace
        # Forget the trace that was not used for the longest time, but never the present one.
        while len(self._traces) > 1 and sum(len(trace.ticks) for trace in self._traces.values()) > MOST_TICKS:
            self._traces.popitem(last=False)
        return trace


simulate = Simulate()  # shared by all tests, so that claims of one scenario are judged on one run


def _run(admitted: Admitted) -> Trace:
    """Run a scenario.

    Raise KeyboardInterrupt after Ctrl-C, and FlakyAvoiderError for a flaky avoider.
    """
    named = session().world
    trace = run_trial(admitted, world=world_named(named, "--safety-world") if named else default_world())
    if trace.ended == INTERRUPTED:
        raise KeyboardInterrupt
    if admitted.driver is None:
        refuse_flaky(admitted.avoider, trace)
    if (test := session().test) is not None:
        test.computing_times += computing_times([trace])
    return trace


def _refuse_more_shrinking(test: TestRun | None, digest: str) -> None:
    """Reject further scenarios once the test has used up the runs that the profile allows after a failure."""
    if test is None or test.counts:
        return
    if digest in test.refused:
        raise test.refused[digest]  # Hypothesis repeats the failing example before it reports it
    if digest in test.failing:
        return
    hopeless = isinstance(test.failure, InputError | FlakyAvoiderError)  # a smaller scenario would not help
    if hopeless or test.runs_since >= session().profile.shrinking_runs:
        from hypothesis import reject

        reject()
    test.runs_since += 1
