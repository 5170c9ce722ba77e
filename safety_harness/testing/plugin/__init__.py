"""Provide the pytest plug-in: hooks, the collection of scenario files, and the summary at the end."""
