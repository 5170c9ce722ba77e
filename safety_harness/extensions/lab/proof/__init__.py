"""Prove claims about all answers of a network on a region of inputs, including the effects of rounding."""
