"""Score an avoider's answers to direct questions, without a simulation and before any gate."""
