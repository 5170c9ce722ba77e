"""A user's avoider in a process of its own, which may hang, end or run out of memory without harm to ours."""
