"""Find the causes of violations by repeating a run with one or two changed ingredients."""
