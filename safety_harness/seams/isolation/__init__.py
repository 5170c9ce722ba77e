"""Run a user's file in a separate process, so that the harness continues if the file hangs or crashes."""
