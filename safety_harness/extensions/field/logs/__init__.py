"""Logs of real cells: the reader puts them on one clock, and makes traces of all that is certain."""
