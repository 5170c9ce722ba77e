"""The user's own properties: temporal formulas over named signals, in Python or as sentences."""
