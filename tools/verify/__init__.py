"""Acceptance tests: scenarios with expectations, played in virtual time and judged."""
