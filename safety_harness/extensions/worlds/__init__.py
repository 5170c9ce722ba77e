"""Provide worlds that do not belong to the core."""
