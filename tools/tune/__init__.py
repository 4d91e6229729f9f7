"""Tuning: every controller by the same cost, budget, optimiser, seed and margin floor."""
