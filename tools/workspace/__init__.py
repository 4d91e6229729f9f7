"""Maps of the workspace: where the cables can balance what, how evenly, and how stiffly."""

from tonus.tools.workspace.maps import Maps, compute, grid
from tonus.tools.workspace.picture import draw

__all__ = ["Maps", "compute", "draw", "grid"]
