"""The pytest plug-in: hooks, the collection of scenario files, what is said at the end."""
