"""Avoiders in a file: no functions of their question and seed, one that is, and one but for rounding."""

from __future__ import annotations

TEXT = """\
import time
import numpy as np
from safety_harness import Proposal


class Pure:
    name = "pure"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        chance = np.random.default_rng(seed).normal(scale=1e-3, size=3)
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.07] + chance)


class Averages(Pure):
    name = "averages with the previous hand"
    before = None

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        hand = hand_position_in_base_m
        mean = hand if self.before is None else (hand + self.before) / 2.0
        self.before = hand.copy()
        return Proposal(tcp_position_in_base_m + 0.1 * (tcp_position_in_base_m - mean))


class Counts(Pure):
    name = "counts its questions"
    asked = 0

    def propose(self, *, tcp_position_in_base_m, **question):
        self.asked += 1
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.05 + 1e-4 * self.asked])


class Drawn(Pure):
    name = "draws from the process's own stream"

    def __init__(self):
        np.random.seed(0)

    def propose(self, *, tcp_position_in_base_m, **question):
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.05 + 0.01 * np.random.random()])


class Clocked(Pure):
    name = "looks at the clock"

    def propose(self, *, tcp_position_in_base_m, **question):
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.05 + 0.02 * (time.time() % 1.0)])


class Batched(Pure):
    name = "answers a batch by its mean hand"

    def propose_many(self, hands, tcps, seeds):
        alone = [
            self.propose(hand_position_in_base_m=h, tcp_position_in_base_m=t, seed=int(s)).position_in_base_m
            for h, t, s in zip(hands, tcps, seeds)
        ]
        return np.array(alone) + 1e-3 * (hands - hands.mean(axis=0)), np.zeros((len(hands), 3))

class Rounds(Pure):
    name = "rounds otherwise in a batch"

    def propose_many(self, hands, tcps, seeds):
        alone = [
            self.propose(hand_position_in_base_m=h, tcp_position_in_base_m=t, seed=int(s)).position_in_base_m
            for h, t, s in zip(hands, tcps, seeds)
        ]
        return np.array(alone) + 1e-13, np.zeros((len(hands), 3))


class Doubts(Rounds):
    name = "is in doubt in a batch only"

    def propose_many(self, hands, tcps, seeds):
        positions, spreads = super().propose_many(hands, tcps, seeds)
        return positions - 1e-13, spreads + 0.01
"""
NO_FUNCTIONS = ("Averages", "Counts", "Clocked", "Batched")
