"""Mutants of the safety path: small errors put into the code one at a time. A test has to fail."""
