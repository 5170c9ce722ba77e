"""Attribution: find the cause of a violation by changing one ingredient of its run at a time, then two."""
