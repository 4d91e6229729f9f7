"""Stability margins of the tension loop and of whole controllers."""
