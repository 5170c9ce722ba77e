"""The reader for logs of real cells, which puts their streams on one clock and makes a trace of them."""
