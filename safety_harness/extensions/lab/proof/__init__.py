"""Proofs about networks: what holds for every question of a region, of the program as it computes."""
