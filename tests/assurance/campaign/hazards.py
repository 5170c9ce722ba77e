"""A plan of which one hazard has all that it may have, and two claims."""

from __future__ import annotations

from tests.assurance.campaign.plans import PLAN

HAZARDS = """\
hazards:
  - hazard: crushed hand
    task: parts are taken from the table
    zone: above the table
    body region: hand and forearm
    initiating event: a hand reaches past the object
    severity: S2
    exposure: F1
    avoidance: P2
    decided by: the author of this test
    because: it is a test
    approaches: {counted: 37, hours: 12, source: two shifts}
"""
GRAPH = """\
risk graph:
  graph: our own
  levels: {S1 F1 P1: low, S1 F1 P2: low, S1 F2 P1: low, S1 F2 P2: low,
    S2 F1 P1: low, S2 F1 P2: high, S2 F2 P1: high, S2 F2 P2: high}
  an hour: {low: 5, high: 1}
"""
HAZARDOUS = PLAN.replace("    hazard: a hand is crushed", "    hazards: [crushed hand]") + HAZARDS
DERIVED = HAZARDOUS.replace("at most: 50 %", "at most: derived") + GRAPH
