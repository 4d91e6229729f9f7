"""Clocks, the fixed period, and what keeps it on a host."""
