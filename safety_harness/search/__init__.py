"""Find scenarios that violate a claim, and shrink them.

A search does not estimate the probability of a violation.
"""
