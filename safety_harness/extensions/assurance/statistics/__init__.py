"""Estimate from declared streams of independent episodes. The coverage of the bounds was measured."""
