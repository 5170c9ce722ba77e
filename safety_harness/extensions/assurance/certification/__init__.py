"""Evidence as one report: results, argument, counterexamples, and a page, which ``verify`` checks again."""
