"""Claims on a cell that runs: samples in, one after another, verdicts out."""
