"""An image within the report: in the file itself, wide enough to be read on a phone."""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


def picture(name: str, place: Path, title: str, caption: str) -> str:
    """A figure element whose image scrolls sideways where the screen is narrow.

    Args:
        name: Of the element.
        place: Of the PNG file.
        title: Of the image, as plain text.
        caption: As HTML.
    """
    data = base64.b64encode(place.read_bytes()).decode("ascii")
    image = f'<img alt="{escape(title)}" src="data:image/png;base64,{data}">'
    return (
        f'<figure id="{name}">\n<div class="scroll" tabindex="0">{image}</div>\n'
        f"<figcaption>{caption}</figcaption>\n</figure>"
    )
