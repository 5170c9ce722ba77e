"""Attribution: change one ingredient of a run at a time, then two, to find the cause of a violation."""
