"""Signals of a trace: values at the ticks, bounds between the ticks, and the errors of values and bounds."""
