"""Whose fault a violation is: the same run again with one ingredient changed at a time, then two."""
