"""Attribute violations to parts of the system, and provide ``safety-harness attribute``."""
