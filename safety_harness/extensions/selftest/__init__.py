"""The harness on trial: faults seeded into a sound system, and what catches them."""
