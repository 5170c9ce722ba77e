"""Evidence put together: results, argument, counterexamples, one page that can be checked again."""
