"""One file for each command of `tonus`."""
