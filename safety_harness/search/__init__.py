"""Search: find scenarios that violate a claim, and return the simplest, without an estimate."""
