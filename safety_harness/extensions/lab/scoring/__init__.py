"""Asking an avoider directly, without a simulation and before any gate, and what its answers are worth."""
