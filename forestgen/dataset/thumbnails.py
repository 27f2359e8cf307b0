"""thumbnails/FRAME.jpg: small pictures of the frames, for pages and for people."""

from __future__ import annotations

import io
from pathlib import Path

from forestgen.core.errors import OutputError
from forestgen.dataset.files import make_folder, write_bytes

FOLDER_NAME = "thumbnails"
LONG_SIDE_PX = 256
_QUALITY = 85


def thumbnail_name(frame: str) -> str:
    """Path of a frame's thumbnail below the data set's folder."""
    return f"{FOLDER_NAME}/{frame}.jpg"


def write_thumbnail(frame_folder: Path, target: Path) -> None:
    """Write a frame's preview.png, at most `LONG_SIDE_PX` long and never enlarged, as JPEG without a date.

    The target's folder is made if it is missing. Without a preview to read it raises `OutputError`.
    """
    from PIL import Image

    source = frame_folder / "preview.png"
    buffer = io.BytesIO()
    try:
        with Image.open(source) as image:
            picture = image.convert("RGB")
            picture.thumbnail((LONG_SIDE_PX, LONG_SIDE_PX), Image.Resampling.LANCZOS, reducing_gap=None)
            picture.save(buffer, "JPEG", quality=_QUALITY, optimize=True)
    except (OSError, ValueError, SyntaxError) as error:  # Pillow's for files that are cut short
        raise OutputError("the preview cannot be read", where=str(source), got=str(error)) from error
    make_folder(target.parent)
    write_bytes(target, buffer.getvalue())
