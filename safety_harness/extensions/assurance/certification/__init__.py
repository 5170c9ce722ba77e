"""Evidence as one report: results, argument, counterexamples, and a page that ``verify`` checks again."""
