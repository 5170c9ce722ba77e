"""Worlds that do not belong to the core."""
