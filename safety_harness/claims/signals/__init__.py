"""Signals of a trace: values at the ticks, bounds between them, and the errors of both."""
