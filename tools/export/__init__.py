"""Descriptions of a configuration for other tools, in their formats."""
