"""The pytest plug-in: its hooks, the collection of scenario files, and the summary at the end."""
