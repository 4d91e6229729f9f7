"""Who may tell a running daemon what to do, and what it tells people."""
