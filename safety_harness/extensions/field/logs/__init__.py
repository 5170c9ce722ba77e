"""Read logs of real cells: put their streams on one clock, and make a trace from them."""
