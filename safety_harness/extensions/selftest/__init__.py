"""Mutation testing of the harness: faults seeded into a sound system, and the claims that catch them."""
