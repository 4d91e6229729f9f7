"""The lab as a whole: its time, its script of faults, its doors, and what it counts."""
