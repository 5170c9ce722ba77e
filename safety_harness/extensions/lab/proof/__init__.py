"""Proofs about networks: claims for every question of a region, and the program's own arithmetic."""
