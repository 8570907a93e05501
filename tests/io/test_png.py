from __future__ import annotations

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from silint.io.png import png16_bytes


def decoded(data):
    """(H, W) or (H, W, 3) of a .png of 16 bits, by the standard's own words; sums of chunks are checked."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, chunks = 8, []
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + 8 + length]
        assert struct.unpack(">I", data[at + 8 + length : at + 12 + length])[0] == zlib.crc32(kind + body)
        chunks.append((kind, body))
        at += 12 + length
    assert chunks[0][0] == b"IHDR" and chunks[-1] == (b"IEND", b"")
    width, height, depth, colour, *rest = struct.unpack(">IIBBBBB", chunks[0][1])
    assert depth == 16 and rest == [0, 0, 0]
    channels = {0: 1, 2: 3}[colour]
    lines = zlib.decompress(b"".join(body for kind, body in chunks if kind == b"IDAT"))
    n = 2 * channels * width
    assert len(lines) == height * (1 + n)
    out, above = [], [0] * n
    for row in range(height):
        line = lines[row * (1 + n) : (row + 1) * (1 + n)]
        assert line[0] in (0, 2)
        above = [(x + (a if line[0] else 0)) % 256 for x, a in zip(line[1:], above, strict=True)]
        out.append(struct.unpack(f">{n // 2}H", bytes(above)))
    shape = (height, width) if channels == 1 else (height, width, 3)
    return np.array(out, np.uint16).reshape(shape)


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (3, 4, 3), (1, 2, 3)])
def test_pixels_come_back(shape):
    pixels = np.random.default_rng(1).integers(0, 65536, shape).astype(np.uint16)
    data = png16_bytes(pixels, "silint", '{"a": 1}')
    assert np.array_equal(decoded(data), pixels)
    with Image.open(io.BytesIO(data)) as image:
        assert image.text == {"silint": '{"a": 1}'} and image.size == (shape[1], shape[0])
        if len(shape) == 2:
            assert np.array_equal(np.array(image), pixels)
        else:  # Pillow keeps the upper eight bits of colours
            assert np.array_equal(np.array(image), pixels >> 8)
