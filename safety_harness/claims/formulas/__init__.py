"""The user's own properties: temporal formulas over named signals, written in Python or as sentences."""
