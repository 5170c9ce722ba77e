"""Run a user's avoider in its own process.

The harness then survives if the avoider hangs, exits or fills its memory.
"""
