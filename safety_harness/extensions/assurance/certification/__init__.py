"""The evidence for a plan as one report, which ``verify`` can check again.

The report has results, an argument, counterexamples and a page.
"""
