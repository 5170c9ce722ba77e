"""Proofs about networks: claims about every question of a region, in the program's own arithmetic."""
