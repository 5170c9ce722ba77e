"""Campaigns: declared plans of many independent episodes, run into a durable ledger."""
