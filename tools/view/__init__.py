"""The robot in a browser: live from the rings of a running daemon, or from a log."""
