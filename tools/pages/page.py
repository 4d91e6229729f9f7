"""A page from its template and what it shows; texts are escaped, pictures stand inside."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

_HERE = Path(__file__).parent
_environment = Environment(
    loader=FileSystemLoader(_HERE),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)


def page(template: str, title: str, **shown: Any) -> str:
    """The page of ``template``, a file of this folder. A name that the template uses and ``shown``
    lacks is an error."""
    style = (_HERE / "style.css").read_text()
    return _environment.get_template(template).render(title=title, style=style, **shown)


def data_url(svg: bytes) -> str:
    """A picture as the source of an ``img``."""
    return f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}"
