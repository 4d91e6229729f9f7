"""Tonus: control of a cable-driven parallel robot, and its lab in software."""
