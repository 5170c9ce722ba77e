"""Run a user's avoider in its own process, which may hang, end or fill its memory without harm to ours."""
