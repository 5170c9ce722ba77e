"""Search: find scenarios that violate a claim, and hand back the simplest; it estimates nothing."""
