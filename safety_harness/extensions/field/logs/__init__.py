"""Logs of real cells: read, placed on one clock, and made traces of what is certain."""
