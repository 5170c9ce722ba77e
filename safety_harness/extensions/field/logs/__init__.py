"""The reader for logs of real cells, which puts their streams on one clock and makes them a trace."""
