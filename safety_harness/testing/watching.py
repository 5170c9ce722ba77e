"""Run a Hypothesis test under a safety profile.

The harness applies the settings of the profile, tries the kept failures first, and watches the examples. The
harness keeps failures as scenario files in a folder that people can read.  In the next session, it tries
these failures first.  Hypothesis's own database stores the choices as bytes.  These bytes lose their meaning
when a space, a strategy or Hypothesis changes, whereas a scenario file keeps its meaning.
"""

from __future__ import annotations

import functools
import hashlib
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, example, settings
from hypothesis.errors import BackendCannotProceed, HypothesisException
from hypothesis.internal.conjecture.providers import AVAILABLE_PROVIDERS, HypothesisProvider

from safety_harness.admission.avoiders import as_seen_from, with_system_of
from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import InputError, OutputError
from safety_harness.base.whole_file import write_whole
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.scenario.write import write_scenario
from safety_harness.testing.asserting import SafetyViolation
from safety_harness.testing.drawing import one_system_of
from safety_harness.testing.session import TestRun, session
from safety_harness.testing.simulating import digest_of

PHASES = (Phase.explicit, Phase.generate, Phase.target, Phase.shrink)
# No deadline: a simulation may take long.  No health check: a test cannot choose its admissible draws.
SUPPRESSED_CHECKS = (
    HealthCheck.too_slow,
    HealthCheck.filter_too_much,
    HealthCheck.data_too_large,
    HealthCheck.large_base_example,
)
ANY = Claim(sentence="trace finite and monotone", expected=Verdict.HOLDS)  # because a file needs a claim
_LONGEST = 60  # characters of one part of a path


def under_profile(own: settings | None = None, *, fixed: bool = False) -> settings:
    """Return the settings of a test, adapted to the profile of the session.

    Args:
        own: the settings of the test; None means Hypothesis's defaults.
        fixed: whether the test itself sets its number of examples, which is then kept.

    """
    own = own or settings.default
    assert own is not None
    examples = own.max_examples if fixed else session().profile.examples
    return settings(
        parent=own,
        max_examples=examples,
        backend=NAME if own.backend == "hypothesis" else own.backend,
        deadline=None,
        # The harness keeps failures as scenario files, and its provider draws with the session's seed.
        database=None,
        derandomize=session().derandomize,
        print_blob=False,
        report_multiple_bugs=False,
        phases=[phase for phase in PHASES if phase in own.phases],
        suppress_health_check=[*own.suppress_health_check, *SUPPRESSED_CHECKS],
    )


@contextmanager
def watched(function: Any, test: TestRun) -> Iterator[None]:
    """Apply ``under_profile`` to ``function``, a test with ``@given``, and restore the test afterwards."""
    # The attributes are not part of Hypothesis's public interface, so ``finally`` restores each of them.
    handle = function.hypothesis
    saved = {
        "_hypothesis_internal_use_settings": function._hypothesis_internal_use_settings,
        "_hypothesis_internal_use_seed": function._hypothesis_internal_use_seed,
        "hypothesis_explicit_examples": getattr(function, "hypothesis_explicit_examples", []),
    }
    inner = handle.inner_test
    own, usual = function._hypothesis_internal_use_settings, settings.default
    assert usual is not None
    # Only a number of examples that the test itself sets stays; the profile replaces the default.
    applied = hasattr(function, "_hypothesis_internal_settings_applied")
    fixed = applied and own.max_examples != usual.max_examples
    function._hypothesis_internal_use_settings = under_profile(own, fixed=fixed)
    if saved["_hypothesis_internal_use_seed"] is None and not session().derandomize:
        function._hypothesis_internal_use_seed = session().seed
    function.hypothesis_explicit_examples = [*saved["hypothesis_explicit_examples"], *_kept(function, test)]
    handle.inner_test = watching(inner, test)
    try:
        yield
    finally:
        handle.inner_test = inner
        for name, value in saved.items():
            setattr(function, name, value)


def watching(inner: Callable[..., object], test: TestRun) -> Callable[..., None]:
    """Return ``inner``, the function for one example, wrapped so that it reports failures to ``test``."""

    @functools.wraps(inner)
    def watched_example(*args: Any, **kwargs: Any) -> None:
        __tracebackhide__ = True
        test.simulated.clear()
        test.examples += 1
        try:
            inner(*args, **kwargs)
        except HypothesisException:  # Hypothesis gives up this draw
            raise
        except Exception as error:
            test.fail(error)
            raise

    return watched_example


def _kept(function: Any, test: TestRun) -> Iterator[Any]:
    """Yield the test's kept failures as explicit examples, if the test draws only a scenario."""
    names = list(function.hypothesis._given_kwargs)
    if len(names) != 1:
        return
    for scenario in kept_for(test, one_system_of(function.hypothesis._given_kwargs[names[0]])):
        yield example(**{names[0]: scenario})._this_example


def folder_of(test_id: str) -> Path:
    """Return the folder that keeps the failures of a test."""
    path, *names = test_id.split("::")
    return session().failures.joinpath(*path.split("/"), *map(_slug, names))


def keep(test_id: str, violation: SafetyViolation) -> Path:
    """Write the scenario of ``violation`` to the test's folder and return the file.

    Raises:
        OutputError: the file cannot be written.

    """
    folder = folder_of(test_id)
    scenario, evaluation = violation.scenario, violation.evaluation
    file = folder / f"{_slug(evaluation.sentence)}-{digest_of(scenario)[:6]}.yaml"
    claim = Claim(sentence=evaluation.sentence, expected=violation.expected)
    claims = (claim,) if _is_known(claim, scenario) else scenario.claims or (ANY,)
    moved = replace(as_seen_from(folder, scenario), claims=claims)
    head = [
        f"A failure of {test_id}",
        f"{evaluation.sentence}: {evaluation.verdict.value}, margin {evaluation.margin_text()}",
        violation.trace.system.label,
        "It is tried first whenever that test runs; delete this file when it need not be any more.",
    ]
    try:
        write_whole(file, "".join(f"# {line}\n" for line in head) + write_scenario(moved))
    except OSError as error:
        raise OutputError.from_os_error(file, error) from error
    return file


def kept_for(test: TestRun, like: Scenario | None) -> Iterator[Scenario]:
    """Yield the kept failures of a test in the order of their file names.

    The file determines the hands and the start.  ``like`` determines the avoider or controller, because the
    test may now use another system.

    Args:
        test: the test, which records each file as replayed.
        like: a scenario with the system that the test uses now; None keeps the system of the file.

    Raises:
        InputError: a file is not valid.

    """
    for file in sorted(folder_of(test.id).glob("*.yaml")):
        if file.is_file():
            scenario = read_scenario(file)
            test.replayed.append(file)
            test.as_kept = like is None
            yield scenario if like is None else with_system_of(like, scenario)


def _is_known(claim: Claim, scenario: Scenario) -> bool:
    """Return whether the harness can read the claim's sentence.

    It may be unable to read the sentence of a user's own property.
    """
    try:
        property_of(claim, scenario)
    except InputError:
        return False
    return True


def _slug(text: str) -> str:
    short = re.sub(r"[^\w.]+", "-", text).strip("-.")[:_LONGEST] or "test"
    same = re.sub(r"[^\w.]+", "-", text) == short
    return short if same else f"{short}-{hashlib.sha256(text.encode()).hexdigest()[:6]}"


NAME = "safety-harness"
_LARGEST = 2**64


class Independent(HypothesisProvider):
    """A Hypothesis provider that draws each number between two bounds independently.

    Hypothesis derives most of its examples from earlier examples. This strategy finds bugs in parsers, but it
    would place half of fifty hands at the same point. This provider therefore draws the first half of the
    examples afresh, with every choice uniform within its bounds. Hypothesis draws the second half, guided by
    the margins of the first half.
    """

    def draw_integer(
        self,
        min_value: int | None = None,
        max_value: int | None = None,
        *,
        weights: dict[int, float] | None = None,
        shrink_towards: int = 0,
    ) -> int:
        """Draw uniformly between two bounds.

        Hypothesis draws instead if a bound is missing or weights apply.
        """
        self._stop_at_half()
        if min_value is None or max_value is None or weights or self._random is None:
            return super().draw_integer(min_value, max_value, weights=weights, shrink_towards=shrink_towards)
        return self._random.randint(min_value, max_value)

    def draw_float(
        self,
        *,
        min_value: float = -inf,
        max_value: float = inf,
        allow_nan: bool = True,
        smallest_nonzero_magnitude: float,
    ) -> float:
        """Draw uniformly between two bounds.

        Hypothesis draws instead if a bound exceeds 2**64.
        """
        self._stop_at_half()
        if not -_LARGEST < min_value <= max_value < _LARGEST or self._random is None:
            return super().draw_float(
                min_value=min_value,
                max_value=max_value,
                allow_nan=allow_nan,
                smallest_nonzero_magnitude=smallest_nonzero_magnitude,
            )
        return self._random.uniform(min_value, max_value)

    def _stop_at_half(self) -> None:
        test = session().test
        if test is None or test.examples >= session().profile.examples // 2:
            raise BackendCannotProceed("exhausted")


AVAILABLE_PROVIDERS[NAME] = Independent
