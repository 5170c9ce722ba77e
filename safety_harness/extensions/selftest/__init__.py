"""Test the harness by mutation: seed faults into a sound system, and see which claims catch them."""
