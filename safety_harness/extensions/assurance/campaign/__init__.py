"""Campaigns: a declared plan of many independent episodes, run and recorded in a durable ledger."""
