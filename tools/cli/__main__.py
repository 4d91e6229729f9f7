"""`python -m tools.cli` is `tonus`."""

from tools.cli.main import main

main()
