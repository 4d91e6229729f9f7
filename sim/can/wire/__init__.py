"""One CAN channel in time, and what can go wrong with its frames (ISO 11898-1)."""
