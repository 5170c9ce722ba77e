"""Microseconds an episode of another tool around a trivial simulator; needs nothing of this package.

Run: PYTHON benchmarks/overhead_of_others.py psy-taliro|verifai DIMENSIONS EPISODES SEED.
"""

from __future__ import annotations

import sys
import time


def psy_taliro(dimensions: int, episodes: int, seed: int) -> float:
    """Uniform random search with a cost function."""
    import staliro
    from staliro import optimizers

    @staliro.costfunc
    def cost(inputs: staliro.Inputs) -> float:
        return float(sum(inputs.static.values())) + 1.0

    box = {f"x{k}": (0.0, 1.0) for k in range(dimensions)}
    options = staliro.TestOptions(runs=1, iterations=episodes, seed=seed, static_inputs=box)
    begun_s = time.perf_counter()
    (run,) = staliro.test(cost, optimizers.UniformRandom(), options)
    elapsed_s = time.perf_counter() - begun_s
    assert len(run.evaluations) == episodes
    return elapsed_s


def verifai(dimensions: int, episodes: int, seed: int) -> float:
    """Uniform random falsification, the simulator in the server's own process: no socket, in its favour."""
    import random

    import numpy as np
    from dotmap import DotMap
    from verifai.falsifier import generic_falsifier
    from verifai.features import Box
    from verifai.monitor import specification_monitor
    from verifai.server import Server

    class InProcess(Server):
        def get_simulation_data(self, sample: object) -> float:
            return float(sum(np.asarray(sample.x).ravel())) + 1.0  # type: ignore[attr-defined]

        def evaluate_sample(self, sample: object) -> float:
            self.lastValue = self.monitor.evaluate(self.get_simulation_data(sample))
            return float(self.lastValue)

    class Sum(specification_monitor):
        def __init__(self) -> None:
            super().__init__(lambda value: value)

    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 (what it draws from)
    parameters = DotMap(n_iters=episodes, save_error_table=False, save_safe_table=False)
    falsifier = generic_falsifier(
        sampler_type="random",
        sample_space={"x": Box(*[[0.0, 1.0]] * dimensions)},
        monitor=Sum(),
        falsifier_params=parameters,
        server_options=DotMap(port=0),
        server_class=InProcess,
    )
    begun_s = time.perf_counter()
    falsifier.run_falsifier()
    elapsed_s = time.perf_counter() - begun_s
    assert len(falsifier.samples) == episodes
    return elapsed_s


def main() -> None:
    """Print the microseconds."""
    tool, dimensions, episodes, seed = sys.argv[1], *map(int, sys.argv[2:5])
    elapsed_s = {"psy-taliro": psy_taliro, "verifai": verifai}[tool](dimensions, episodes, seed)
    sys.stdout.write(f"{elapsed_s / episodes * 1e6}\n")


if __name__ == "__main__":
    main()
