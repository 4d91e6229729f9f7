"""What other tools want to know of a configuration, in their own formats."""
