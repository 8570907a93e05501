"""A writer of .png with 16 bits a channel, which Pillow has for grey pictures only [W3C03].

References
----------
W3C03
    Portable network graphics (PNG) specification, second edition, W3C 2003 (ISO/IEC 15948).
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
import numpy.typing as npt

__all__ = ["png16_bytes"]

_GREY, _RGB = 0, 2
_UP = 2
# Of zlib: the highest levels take several times as long for a percent or two.
_LEVEL = 6


def png16_bytes(pixels: npt.NDArray[np.uint16], keyword: str, text: str) -> bytes:
    """A picture as the bytes of a .png file.

    Parameters
    ----------
    pixels : (H, W) or (H, W, 3) uint16
        The top row first.
    keyword, text : str
        A text chunk; ASCII.

    Returns
    -------
    bytes
    """
    height, width = pixels.shape[:2]
    # Big endian; filtered rows are differences from the row above, byte by byte, which compress better.
    rows = np.ascontiguousarray(pixels.reshape(height, -1), dtype=">u2").view(np.uint8)
    filtered = np.empty((height, 1 + rows.shape[1]), np.uint8)
    filtered[:, 0] = _UP
    filtered[0, 1:] = rows[0]
    np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
    header = struct.pack(">IIBBBBB", width, height, 16, _GREY if pixels.ndim == 2 else _RGB, 0, 0, 0)
    return b"".join(
        (
            b"\x89PNG\r\n\x1a\n",
            _chunk(b"IHDR", header),
            _chunk(b"tEXt", keyword.encode("ascii") + b"\0" + text.encode("ascii")),
            _chunk(b"IDAT", zlib.compress(filtered.tobytes(), _LEVEL)),
            _chunk(b"IEND", b""),
        )
    )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
