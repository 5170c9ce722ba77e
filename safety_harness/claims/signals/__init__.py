"""Signals of a trace: values at the ticks, bounds between them, and what their uncertainty makes of both."""
