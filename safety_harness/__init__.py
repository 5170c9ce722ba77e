"""Verify, in simulation, a learned controller that moves a visually servoed robot away from hands.

    from pathlib import Path
    from safety_harness import admit, judge, read_scenario, run_trial

    trace = run_trial(admit(read_scenario(Path("scenarios/hand-visits-and-leaves.yaml"))))
    for evaluation in judge(trace):
        print(evaluation.sentence, evaluation.verdict.value, evaluation.margin_text())

The names listed below are the public interface, and a test checks the list.  Each name is imported at its
first use, so that ``safety-harness --help`` does not wait for a physics engine.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from safety_harness.admission.admit import Admitted as Admitted
    from safety_harness.admission.admit import admit as admit
    from safety_harness.admission.avoiders import shipped_avoider as shipped_avoider
    from safety_harness.admission.spaces import AdmittedDraws as AdmittedDraws
    from safety_harness.admission.spaces import draw_admissible as draw_admissible
    from safety_harness.admission.trial import judge as judge
    from safety_harness.admission.trial import run_kinematic as run_kinematic
    from safety_harness.admission.trial import run_many as run_many
    from safety_harness.admission.trial import run_trial as run_trial
    from safety_harness.base.exceptions import InputError as InputError
    from safety_harness.base.exceptions import SafetyHarnessError as SafetyHarnessError
    from safety_harness.base.output import Output as Output
    from safety_harness.base.settings import DEFAULTS as DEFAULTS
    from safety_harness.base.settings import Settings as Settings
    from safety_harness.cell.avoidance.avoider import Avoider as Avoider
    from safety_harness.cell.avoidance.avoider import AvoiderAround as AvoiderAround
    from safety_harness.cell.avoidance.avoider import Proposal as Proposal
    from safety_harness.cell.simulation.worlds import KINEMATIC as KINEMATIC
    from safety_harness.cell.simulation.worlds import PYBULLET as PYBULLET
    from safety_harness.cell.simulation.worlds import WORLDS as WORLDS
    from safety_harness.cell.simulation.worlds import WorldEntry as WorldEntry
    from safety_harness.claims.formulas.claim import FormulaClaim as FormulaClaim
    from safety_harness.claims.formulas.parse import parse_formula as parse_formula
    from safety_harness.claims.properties.base import Evaluation as Evaluation
    from safety_harness.claims.properties.base import Property as Property
    from safety_harness.extensions.assurance.certify_job import CertificationResult as CertificationResult
    from safety_harness.extensions.assurance.certify_job import certify as certify
    from safety_harness.extensions.attribution.attribute_job import AttributionResult as AttributionResult
    from safety_harness.extensions.attribution.attribute_job import attribute as attribute
    from safety_harness.extensions.field.read_log_job import LogResult as LogResult
    from safety_harness.extensions.field.read_log_job import read_log as read_log
    from safety_harness.extensions.lab.evaluate_job import EvaluationResult as EvaluationResult
    from safety_harness.extensions.lab.evaluate_job import evaluate as evaluate
    from safety_harness.extensions.lab.prove_job import ProofResult as ProofResult
    from safety_harness.extensions.lab.prove_job import prove as prove
    from safety_harness.extensions.pages.run_page import write_report as write_report
    from safety_harness.report.evidence import JudgedRun as JudgedRun
    from safety_harness.report.run_job import run as run
    from safety_harness.report.run_result import RunResult as RunResult
    from safety_harness.report.search_job import SearchResult as SearchResult
    from safety_harness.report.search_job import fuzz as fuzz
    from safety_harness.scenario.model import Scenario as Scenario
    from safety_harness.scenario.model import Verdict as Verdict
    from safety_harness.scenario.read import parse_scenario as parse_scenario
    from safety_harness.scenario.read import read_scenario as read_scenario
    from safety_harness.scenario.write import write_scenario as write_scenario
    from safety_harness.seams.contract import HandSet as HandSet
    from safety_harness.seams.contract import Move as Move
    from safety_harness.seams.contract import Moves as Moves
    from safety_harness.seams.contract import Predicted as Predicted
    from safety_harness.seams.contract import Report as Report
    from safety_harness.seams.contract import Seen as Seen
    from safety_harness.seams.contract import Stop as Stop
    from safety_harness.seams.contract import UserController as UserController
    from safety_harness.search.coverage import Coverage as Coverage
    from safety_harness.search.cube import Column as Column
    from safety_harness.search.cube import Cube as Cube
    from safety_harness.search.findings import Findings as Findings
    from safety_harness.search.findings import Goal as Goal
    from safety_harness.search.findings import Outcomes as Outcomes
    from safety_harness.search.search import find_violations as find_violations
    from safety_harness.search.searchers import searcher_named as searcher_named
    from safety_harness.search.shrink import shrink as shrink
    from safety_harness.search.trials import Trials as Trials
    from safety_harness.search.trials import in_kinematic as in_kinematic
    from safety_harness.search.trials import in_pybullet as in_pybullet
    from safety_harness.space.distributions import InBox as InBox
    from safety_harness.space.distributions import InRegion as InRegion
    from safety_harness.space.distributions import InShell as InShell
    from safety_harness.space.distributions import TruncatedNormal as TruncatedNormal
    from safety_harness.space.distributions import Uniform as Uniform
    from safety_harness.space.read import parse_space as parse_space
    from safety_harness.space.read import read_space as read_space
    from safety_harness.space.space import ScenarioSpace as ScenarioSpace
    from safety_harness.space.strategy import strategy as strategy
    from safety_harness.space.typed import OneOf as OneOf
    from safety_harness.space.typed import Ref as Ref
    from safety_harness.space.typed import Repeat as Repeat
    from safety_harness.space.typed import Switch as Switch
    from safety_harness.space.typed import space_from as space_from
    from safety_harness.space.writing import write_space as write_space
    from safety_harness.trace.compare import first_difference as first_difference
    from safety_harness.trace.store import load_trace as load_trace
    from safety_harness.trace.store import save_trace as save_trace
    from safety_harness.trace.trace import Trace as Trace

_HOMES = {
    "admission.admit": ("Admitted", "admit"),
    "admission.avoiders": ("shipped_avoider",),
    "admission.spaces": ("AdmittedDraws", "draw_admissible"),
    "admission.trial": ("judge", "run_kinematic", "run_many", "run_trial"),
    "cell.avoidance.avoider": ("Avoider", "AvoiderAround", "Proposal"),
    "seams.contract": (
        "HandSet",
        "Move",
        "Moves",
        "Predicted",
        "Report",
        "Seen",
        "Stop",
        "UserController",
    ),
    "base.exceptions": ("InputError", "SafetyHarnessError"),
    "base.output": ("Output",),
    "claims.formulas.claim": ("FormulaClaim",),
    "claims.formulas.parse": ("parse_formula",),
    "claims.properties.base": ("Evaluation", "Property"),
    "report.evidence": ("JudgedRun",),
    "report.run_job": ("run",),
    "report.run_result": ("RunResult",),
    "report.search_job": ("SearchResult", "fuzz"),
    "scenario.model": ("Scenario", "Verdict"),
    "scenario.read": ("parse_scenario", "read_scenario"),
    "scenario.write": ("write_scenario",),
    "search.coverage": ("Coverage",),
    "search.cube": ("Column", "Cube"),
    "search.findings": ("Findings", "Goal", "Outcomes"),
    "search.search": ("find_violations",),
    "search.searchers": ("searcher_named",),
    "search.shrink": ("shrink",),
    "search.trials": ("Trials", "in_kinematic", "in_pybullet"),
    "base.settings": ("DEFAULTS", "Settings"),
    "cell.simulation.worlds": ("KINEMATIC", "PYBULLET", "WORLDS", "WorldEntry"),
    "space.distributions": ("InBox", "InRegion", "InShell", "TruncatedNormal", "Uniform"),
    "space.read": ("parse_space", "read_space"),
    "space.space": ("ScenarioSpace",),
    "space.strategy": ("strategy",),
    "space.typed": ("OneOf", "Ref", "Repeat", "Switch", "space_from"),
    "space.writing": ("write_space",),
    "trace.compare": ("first_difference",),
    "trace.store": ("load_trace", "save_trace"),
    "trace.trace": ("Trace",),
}
# The only place where the core names a wing; a name's wing is imported when it is first used.
_WINGS = {
    # docs/tables.py writes these lines.
    "extensions.assurance.certify_job": ("CertificationResult", "certify"),
    "extensions.attribution.attribute_job": ("AttributionResult", "attribute"),
    "extensions.field.read_log_job": ("LogResult", "read_log"),
    "extensions.lab.evaluate_job": ("EvaluationResult", "evaluate"),
    "extensions.lab.prove_job": ("ProofResult", "prove"),
    "extensions.pages.run_page": ("write_report",),
    # end
}
__all__ = sorted(name for names in (_HOMES | _WINGS).values() for name in names)

import_module(f"{__name__}.base.moved")  # finds old import paths of documented names


def __getattr__(name: str) -> object:
    for home, names in (_HOMES | _WINGS).items():
        if name in names:
            try:
                return getattr(import_module(f"{__name__}.{home}"), name)
            except ModuleNotFoundError as error:
                if home in _WINGS and error.name and f"{__name__}.{home}".startswith(error.name):
                    raise _absent(name, home) from error
                raise
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _absent(name: str, home: str) -> InputError:
    """Return the error for ``name`` if its wing ``home`` is not installed.

    A wing is an optional package.
    """
    errors, distribution = (import_module(f"{__name__}.base.{mod}") for mod in ("exceptions", "distribution"))
    missing: InputError = errors.MissingPackageError(
        place=errors.Place(field=f"{__name__}.{name}"),
        expected=f"the package {__name__}.{home.rpartition('.')[0]}",
        got="no such package",
        hint=f"pip install --force-reinstall {distribution.DISTRIBUTION}",
    )
    return missing
