"""Campaigns: a declared plan, run episode by episode in many processes, into a ledger that loses nothing."""
