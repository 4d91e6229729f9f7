"""`python -m tonus.tools.cli` is `tonus`."""

from tonus.tools.cli.main import main

main()
