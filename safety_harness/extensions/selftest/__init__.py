"""Test the harness by mutation: seed faults into a correct system, and check which claims catch them."""
