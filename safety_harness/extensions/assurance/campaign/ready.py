"""Check a plan's world and avoiders before its runs.

The world and the avoiders must answer, and a user's simulator must give the same run twice.
"""

from __future__ import annotations

from safety_harness.admission.admit import refuse_no_answer
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import InadmissibleError, Place, SimulationError
from safety_harness.cell.simulation.worlds import OTHER_BITS, SIMULATOR, named_by_user
from safety_harness.extensions.assurance.campaign.episodes import Drawn, EpisodeRunner
from safety_harness.extensions.assurance.campaign.plan import Plan, scenarios_by_avoider
from safety_harness.trace.compare import first_difference

HINT = "a reset must set everything anew, also random numbers, which it seeds with `seed`"


def refuse_unready(plan: Plan) -> None:
    """Raise an error unless the plan's runs can begin.

    The function runs the first episode of each stratum twice in a user's simulator, and both traces must be
    equal.

    Args:
        plan: The plan that the user wants to run.

    Raises:
        InputError: An avoider cannot be made, or the simulator fails, or the simulator does not repeat a run
            exactly.
        InstallationError: The world is not installed.

    """
    place = Place(file=plan.file, field="world")
    try:
        named_by_user(plan.world).opener()
    except InadmissibleError as error:  # names a program that is not there
        raise InadmissibleError(
            place=place, expected=error.expected, got=error.got, hint=error.hint
        ) from error
    for scenario in scenarios_by_avoider(plan):
        refuse_no_answer(scenario)
    if plan.world.program:
        for stratum in range(len(plan.strata)):
            _refuse_unrepeatable(plan, stratum)


def _refuse_unrepeatable(plan: Plan, stratum: int) -> None:
    """Raise InadmissibleError unless two runs of a stratum's first episode have equal traces."""
    drawn = EpisodeRunner(plan).draw(stratum, 0)
    if not isinstance(drawn, Drawn):  # the episode's row will say why
        return
    place = Place(file=plan.file, field="world")
    try:
        first, second = (run_trial(drawn.admitted, world=plan.world) for _ in range(2))
    except SimulationError as error:
        expected = f"a simulator that runs {drawn.admitted.scenario.name}"
        raise InadmissibleError(place=place, expected=expected, got=str(error)) from error
    difference: object = first_difference(first, second)
    if difference is None and OTHER_BITS in dict(first.provenance.libraries).get(SIMULATOR, ""):
        difference = "another motion in a second episode with slow set points"
    if difference is not None:
        expected = f"a simulator that repeats {drawn.admitted.scenario.name} to the last bit"
        raise InadmissibleError(place=place, expected=expected, got=str(difference), hint=HINT)
