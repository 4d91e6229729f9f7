"""What this host grants and refuses a real-time loop, measured: one file for each kind of thing
looked at, findings with a verdict and the command that would better it, and the last report kept.
"""
