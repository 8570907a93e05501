"""Image files to linear radiance.

.hdr is read here: the common readers turn it into 8 bits, or bring a large library. .exr goes through the
optional OpenEXR package, .png and .jpg through Pillow.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.validation import InputError

__all__ = ["IMAGE_SUFFIXES", "ImageData", "decode_rgbe", "read_image", "srgb_to_linear"]

IMAGE_SUFFIXES = (".hdr", ".exr", ".png", ".jpg", ".jpeg")

Float32Array = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]

_MAX_SIDE = 1 << 16
_RESOLUTION = re.compile(rb"([-+])Y (\d{1,9}) ([-+])X (\d{1,9})")


class ImageData(NamedTuple):
    """An image as linear values."""

    pixels: Float32Array
    """(H, W, C) float32, the top row first; C is 1 or 3 (Rec. 709 primaries)."""
    high_range: bool
    """False for .png and .jpg, which end at white."""


def read_image(path: str | os.PathLike[str]) -> ImageData:
    """Read an image file.

    Parameters
    ----------
    path : str or path-like
        A file whose suffix is one of `IMAGE_SUFFIXES`. Values of .png and .jpg are decoded from sRGB; alpha
        is ignored.

    Returns
    -------
    ImageData

    Raises
    ------
    InputError
        In one line that names the file: it is missing, of an unknown kind, damaged or cut short, or needs
        a package that is not installed.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in IMAGE_SUFFIXES:
        raise InputError(
            f"{file}: unknown suffix {file.suffix!r}; expected one of {', '.join(IMAGE_SUFFIXES)}"
        )
    try:
        if file.exists() and not file.is_file():
            raise InputError("is not a regular file; expected an image")
        if file.stat().st_size == 0:
            raise InputError("is empty (0 bytes)")
        if suffix == ".hdr":
            return ImageData(decode_rgbe(file.read_bytes()), True)
        if suffix == ".exr":
            return ImageData(_read_exr(file), True)
        return ImageData(_read_ldr(file), False)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror or _one_line(error)})") from None


def decode_rgbe(data: bytes) -> Float32Array:
    """Decode a Radiance picture (.hdr).

    Pixels flat, in the old run lengths (repeats of a pixel) or the new ones (each component of a scanline
    by itself) [Ward91]. A component is m 2^(e - 136), as most programs have it. EXPOSURE and COLORCORR,
    which say what pixels were multiplied with, are divided out.

    Parameters
    ----------
    data : bytes
        The file.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)

    Raises
    ------
    InputError
        Not such a file, cut short, or in XYZ.
    """
    scale, height, width, flip_rows, flip_columns, position = _rgbe_header(data)
    body = np.frombuffer(data, np.uint8)
    rgbe = np.empty((height, width, 4), np.uint8)
    for row in range(height):
        try:
            position = _rgbe_scanline(body, position, rgbe[row])
        except IndexError:
            raise InputError(f"ends in row {row} of {height}: cut short") from None
    if flip_rows:
        rgbe = rgbe[::-1]
    if flip_columns:
        rgbe = rgbe[:, ::-1]
    exponent = rgbe[..., 3:].astype(np.int32)
    unit = np.where(exponent > 0, np.ldexp(1.0, exponent - 136), 0.0)
    pixels: Float32Array = (rgbe[..., :3] * (unit / scale)).astype(np.float32)
    return pixels


def _rgbe_header(data: bytes) -> tuple[npt.NDArray[np.float64], int, int, bool, bool, int]:
    """Divisors (3,), height, width, bottom row first?, right column first?, and where pixels begin."""
    if not data.startswith(b"#?"):
        raise InputError("does not begin with '#?RADIANCE'; not a Radiance .hdr file")
    scale = np.ones(3)
    position = 0
    while True:
        end = data.find(b"\n", position)
        if end < 0:
            raise InputError("ends within its header: cut short")
        line = data[position:end].strip()
        position = end + 1
        if not line:
            break
        key, _, value = line.partition(b"=")
        if key == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe":
            raise InputError(f"has format {_one_line(value.decode('latin-1'))}; expected 32-bit_rle_rgbe")
        if key in (b"EXPOSURE", b"COLORCORR"):
            scale *= _divisors(key, value)
    end = data.find(b"\n", position)
    line = data[position : max(end, position)].strip()
    found = _RESOLUTION.fullmatch(line)
    if found is None:
        shown = _one_line(line[:60].decode("latin-1"))
        raise InputError(f"has the resolution line {shown!r}; expected one like '-Y 512 +X 1024'")
    height, width = int(found[2]), int(found[4])
    if not (0 < height <= _MAX_SIDE and 0 < width <= _MAX_SIDE):
        raise InputError(f"is {width} x {height} pixels; expected 1 to {_MAX_SIDE} each way")
    return scale, height, width, found[1] == b"+", found[3] == b"-", end + 1


def _divisors(key: bytes, value: bytes) -> npt.NDArray[np.float64]:
    try:
        numbers = [float(word) for word in value.split()]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 3) or not all(0.0 < x < math.inf for x in numbers):
        raise InputError(f"has {key.decode()}={_one_line(value.decode('latin-1'))}; expected numbers above 0")
    return np.array(numbers)


def _rgbe_scanline(body: Bytes, position: int, row: Bytes) -> int:
    """Decode a scanline (W, 4) from `position`; where the next one begins, or IndexError if bytes run out."""
    width = len(row)
    head = body[position : position + 4].tolist()
    if len(head) < 4:
        raise IndexError
    if 8 <= width < 32768 and head[0] == head[1] == 2 and head[2] < 128:
        if head[2] << 8 | head[3] != width:
            raise InputError(f"has a scanline of {head[2] << 8 | head[3]} pixels; expected {width}")
        position += 4
        for component in range(4):
            position = _component_runs(body, position, row[:, component])
        return position
    return _pixel_runs(body, position, row)


def _component_runs(body: Bytes, position: int, out: Bytes) -> int:
    width = len(out)
    filled = 0
    while filled < width:
        count = int(body[position])
        run = count > 128
        if run:
            count -= 128
        if count == 0 or filled + count > width:
            raise InputError("has a run that leaves its scanline; damaged")
        n_bytes = 1 if run else count
        piece = body[position + 1 : position + 1 + n_bytes]
        if len(piece) < n_bytes:
            raise IndexError
        out[filled : filled + count] = piece
        filled += count
        position += 1 + n_bytes
    return position


def _pixel_runs(body: Bytes, position: int, row: Bytes) -> int:
    """Flat pixels, where (1, 1, 1, n) repeats the last pixel n times, and further such ones n 256^i times."""
    width = len(row)
    flat = body[position : position + 4 * width]
    if len(flat) == 4 * width and not (flat.reshape(-1, 4)[:, :3] == 1).all(axis=1).any():
        row[:] = flat.reshape(-1, 4)
        return position + 4 * width
    filled, shift = 0, 0
    while filled < width:
        pixel = body[position : position + 4]
        if len(pixel) < 4:
            raise IndexError
        position += 4
        if pixel[0] == pixel[1] == pixel[2] == 1:
            count = int(pixel[3]) << shift
            if filled == 0 or filled + count > width:
                raise InputError("has a run that leaves its scanline; damaged")
            row[filled : filled + count] = row[filled - 1]
            filled += count
            shift += 8
        else:
            row[filled] = pixel
            filled += 1
            shift = 0
    return position


def _read_exr(file: Path) -> Float32Array:
    try:
        import OpenEXR
    except ImportError:
        raise InputError(
            "reading .exr needs the OpenEXR package: pip install 'silint[exr]', or convert it to .hdr"
        ) from None
    try:
        with OpenEXR.File(str(file), separate_channels=True) as opened:
            channels = {name: np.array(channel.pixels) for name, channel in opened.channels().items()}
    except Exception as error:  # the package raises whatever its C++ side has thrown
        raise InputError(f"not a valid .exr file, or cut short ({_one_line(error)})") from None
    return _exr_pixels(channels)


def _exr_pixels(channels: dict[str, npt.NDArray[Any]]) -> Float32Array:
    """(H, W, C) from channels by name, be they R, G, B, or Y, or those of the first layer that has them."""
    layers = sorted({name.rpartition(".")[0] for name in channels})
    for layer in layers:
        prefix = layer + "." if layer else ""
        for names in (("R", "G", "B"), ("Y",)):
            found = [channels[prefix + name] for name in names if prefix + name in channels]
            if len(found) == len(names) and len({part.shape for part in found}) == 1:
                if names == ("Y",) and prefix + "RY" in channels:
                    raise InputError("stores luminance and chroma; expected channels R, G, B, or Y alone")
                return np.stack(found, axis=-1).astype(np.float32)
    shown = _one_line(", ".join(sorted(channels)) or "none")
    raise InputError(f"has channels {shown}; expected R, G, B, or Y")


def _read_ldr(file: Path) -> Float32Array:
    from PIL import Image

    try:
        with warnings.catch_warnings(), Image.open(file) as image:
            warnings.simplefilter("ignore")
            deep = image.mode.startswith("I")  # 16 bits of grey
            pixels = np.asarray(image if deep else image.convert("RGB"))
    except Exception as error:  # Pillow raises OSError, SyntaxError, ValueError and its own
        if isinstance(error, OSError) and error.errno is not None:
            raise  # the file system's own
        raise InputError(f"not a valid {file.suffix} file, or cut short ({_one_line(error)})") from None
    encoded = pixels.reshape(*pixels.shape[:2], -1) / (65535.0 if deep else 255.0)
    return srgb_to_linear(encoded).astype(np.float32)


def srgb_to_linear(encoded: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Linear values of sRGB-encoded ones, both in [0, 1] [IEC 61966-2-1]."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _one_line(thing: object) -> str:
    """An exception or a text in at most 120 printable characters."""
    text = "".join(c if c.isprintable() else "?" for c in " ".join(str(thing).split()))
    text = text or type(thing).__name__
    return text if len(text) <= 120 else text[:117] + "..."
