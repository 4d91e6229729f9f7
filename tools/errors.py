"""The error of the tools: the command line prints it as one line and exits with code 2."""

from __future__ import annotations


class ToolError(Exception):
    """Bad usage or bad input; the text names the file, the place and the remedy."""
