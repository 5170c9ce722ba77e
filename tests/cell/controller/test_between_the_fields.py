from __future__ import annotations

from dataclasses import replace

import numpy as np
from bench import AWAY, Bench
from examples import Displaced, ur10_gate

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.simple import OppositePose
from safety_harness.trace.records import Mode


def modes_of_a_stop(rubbish: int | None) -> list[int]:
    """A hand from which no way leads, then none; ``rubbish`` fills what no field of an observation uses."""
    no_fallback = replace(
        ur10_gate(DEFAULTS),
        fallback=OppositePose(3.0),
    )
    bench = Bench(avoider=Displaced((0.0, 3.0, 0.0)), gate=no_fallback)
    observe = bench.observation

    def observation(hands: tuple[object, ...]) -> np.ndarray:
        made = observe(hands)  # type: ignore[arg-type]
        used = np.zeros(made.dtype.itemsize, bool)
        for kind, offset in (made.dtype.fields or {}).values():
            used[offset : offset + kind.itemsize] = True
        assert not used.all()
        if rubbish is not None:
            made.view(np.uint8)[~used] = rubbish
        return made

    bench.observation = observation  # type: ignore[method-assign, assignment]
    bench.tick(bench.beside(0.3))
    return [int(bench.tick(AWAY)["mode"]) for _ in range(250)]


def test_what_lies_between_the_fields_of_an_observation_is_not_read() -> None:
    modes = modes_of_a_stop(None)
    assert (modes[0], modes[-1]) == (Mode.PROTECTIVE_STOP, Mode.SERVOING)
    assert modes_of_a_stop(0x40) == modes  # 32.5 as a float
    assert modes_of_a_stop(0xFF) == modes  # not a number
