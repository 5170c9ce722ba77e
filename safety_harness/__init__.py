"""Verify a learned hand-avoidance controller of a visually servoed robot, in simulation.

    from pathlib import Path
    from safety_harness import admit, judge, read_scenario, run_trial

    trace = run_trial(admit(read_scenario(Path("scenarios/hand-visits-and-leaves.yaml"))))
    for evaluation in judge(trace):
        print(evaluation.sentence, evaluation.verdict.value, evaluation.margin_text())

The names below are public; a test holds them.  They are imported when they are first used, so that
``safety-harness --help`` does not wait for a physics engine.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from safety_harness.admission.admit import Admitted, admit
    from safety_harness.admission.spaces import AdmittedDraws, draw_admissible
    from safety_harness.admission.trial import judge, run_kinematic, run_many, run_trial
    from safety_harness.avoidance.avoider import Avoider, Proposal
    from safety_harness.exceptions import InputError, SafetyHarnessError
    from safety_harness.formulas.claim import FormulaClaim
    from safety_harness.formulas.parse import parse_formula
    from safety_harness.properties.base import Evaluation, Property
    from safety_harness.report.evidence import JudgedRun
    from safety_harness.report.html import write_report
    from safety_harness.scenario.model import Scenario, Verdict
    from safety_harness.scenario.read import parse_scenario, read_scenario
    from safety_harness.scenario.write import write_scenario
    from safety_harness.search.coverage import Coverage
    from safety_harness.search.cube import Column, Cube
    from safety_harness.search.findings import Findings, Goal, Outcomes
    from safety_harness.search.search import find_violations
    from safety_harness.search.searchers import searcher_named
    from safety_harness.search.shrink import shrink
    from safety_harness.search.trials import Trials, in_kinematic, in_pybullet
    from safety_harness.settings import DEFAULTS, Settings
    from safety_harness.simulation.worlds import KINEMATIC, PYBULLET, WORLDS, WorldEntry
    from safety_harness.space.distributions import InBox, InRegion, InShell, TruncatedNormal, Uniform
    from safety_harness.space.read import parse_space, read_space
    from safety_harness.space.space import ScenarioSpace
    from safety_harness.space.strategy import strategy
    from safety_harness.space.typed import OneOf, Ref, Repeat, Switch, space_from
    from safety_harness.space.writing import write_space
    from safety_harness.trace.compare import first_difference
    from safety_harness.trace.store import load_trace, save_trace
    from safety_harness.trace.trace import Trace

__all__ = [
    "DEFAULTS",
    "KINEMATIC",
    "PYBULLET",
    "WORLDS",
    "Admitted",
    "AdmittedDraws",
    "Avoider",
    "Column",
    "Coverage",
    "Cube",
    "Evaluation",
    "Findings",
    "FormulaClaim",
    "Goal",
    "InBox",
    "InRegion",
    "InShell",
    "InputError",
    "JudgedRun",
    "OneOf",
    "Outcomes",
    "Property",
    "Proposal",
    "Ref",
    "Repeat",
    "SafetyHarnessError",
    "Scenario",
    "ScenarioSpace",
    "Settings",
    "Switch",
    "Trace",
    "Trials",
    "TruncatedNormal",
    "Uniform",
    "Verdict",
    "WorldEntry",
    "admit",
    "draw_admissible",
    "find_violations",
    "first_difference",
    "in_kinematic",
    "in_pybullet",
    "judge",
    "load_trace",
    "parse_formula",
    "parse_scenario",
    "parse_space",
    "read_scenario",
    "read_space",
    "run_kinematic",
    "run_many",
    "run_trial",
    "save_trace",
    "searcher_named",
    "shrink",
    "space_from",
    "strategy",
    "write_report",
    "write_scenario",
    "write_space",
]

_HOMES = {
    "admission.admit": ("Admitted", "admit"),
    "admission.spaces": ("AdmittedDraws", "draw_admissible"),
    "admission.trial": ("judge", "run_kinematic", "run_many", "run_trial"),
    "avoidance.avoider": ("Avoider", "Proposal"),
    "exceptions": ("InputError", "SafetyHarnessError"),
    "formulas.claim": ("FormulaClaim",),
    "formulas.parse": ("parse_formula",),
    "properties.base": ("Evaluation", "Property"),
    "report.evidence": ("JudgedRun",),
    "report.html": ("write_report",),
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
    "settings": ("DEFAULTS", "Settings"),
    "simulation.worlds": ("KINEMATIC", "PYBULLET", "WORLDS", "WorldEntry"),
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


def __getattr__(name: str) -> object:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
