"""Scenarios and spaces made from the logs of real cells, and comparisons of both worlds with these logs."""
