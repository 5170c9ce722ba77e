"""Monitor a live cell: judge claims on it as its samples arrive."""
