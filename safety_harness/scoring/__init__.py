"""Scores any avoider directly: questions in, figures out, before the gate and without simulation."""
