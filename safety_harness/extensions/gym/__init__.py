"""Provide worlds as Gymnasium environments. Importing this package registers ``SafetyHarness-v0``.

``gymnasium.make("safety_harness.gym:SafetyHarness-v0", space="unseen-both.yaml")`` also imports this package.
The environments are described in docs/how-to/environments.md.
"""

from safety_harness.base.extras import GYM

ENVIRONMENT_ID = "SafetyHarness-v0"


def register_environments() -> None:
    """Register the environment once; raise MissingPackageError if Gymnasium is not installed."""
    with GYM.needed("environments"):
        from gymnasium.envs.registration import register, registry

    if ENVIRONMENT_ID not in registry:
        register(
            id=ENVIRONMENT_ID,
            entry_point="safety_harness.extensions.gym.environment:HarnessEnv",
            vector_entry_point="safety_harness.extensions.gym.vector:HarnessVectorEnv",
        )


register_environments()
