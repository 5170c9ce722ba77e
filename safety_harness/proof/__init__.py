"""Proofs about networks: what holds for every input of a region, of the program as it computes."""
