"""Recorded cells beside simulation: scenarios and spaces made of their logs, and worlds held against them."""
