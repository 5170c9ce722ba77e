"""A user's file in a process of its own: if the file hangs, ends or fills its memory, ours continues."""
