"""`python -m tonus.tools.cli` is `tonus`."""

from tonus.tools.cli.entry import main

main()
