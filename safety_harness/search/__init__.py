"""Search: find scenarios that violate a claim, and shrink them, without an estimate of their probability."""
