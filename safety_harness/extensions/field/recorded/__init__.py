"""Recorded cells beside simulation: scenarios and spaces from their logs, and worlds compared with them."""
