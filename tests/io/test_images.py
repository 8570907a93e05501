"""Image files: Radiance pictures from hand-made bytes, EXR through its package, sRGB, and what is refused."""

from __future__ import annotations

import sys
import types
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from silint import InputError
from silint.io import images
from silint.io.images import decode_rgbe, read_image

HEADER = b"#?RADIANCE\n# a comment\nFORMAT=32-bit_rle_rgbe\n\n"


def picture(body: bytes, height: int = 1, width: int = 2, header: bytes = HEADER) -> bytes:
    return header + b"-Y %d +X %d\n" % (height, width) + body


def values(rgbe: np.ndarray) -> np.ndarray:
    """Written out one by one: m 2^(e - 136), and 0 where e is 0."""
    flat = [
        [m * 2.0 ** (int(e) - 136) if e else 0.0 for m in (int(r), int(g), int(b))]
        for r, g, b, e in rgbe.reshape(-1, 4)
    ]
    return np.array(flat).reshape(*rgbe.shape[:-1], 3)


def encode_runs(component: np.ndarray) -> bytes:
    """One component of a scanline: runs of equal bytes from 3 on, else literals."""
    out, i = bytearray(), 0
    while i < len(component):
        same = 1
        while i + same < len(component) and same < 127 and component[i + same] == component[i]:
            same += 1
        if same >= 3:
            out += bytes([128 + same, component[i]])
            i += same
        else:
            n = min(len(component) - i, 5)
            out += bytes([n]) + component[i : i + n].tobytes()
            i += n
    return bytes(out)


def encode(rgbe: np.ndarray) -> bytes:
    height, width, _ = rgbe.shape
    body = b""
    for row in rgbe:
        body += bytes([2, 2, width >> 8, width & 255]) + b"".join(encode_runs(row[:, c]) for c in range(4))
    return picture(body, height, width)


def test_flat_pixels() -> None:
    # 1.0 is 128 at exponent 129; exponent 0 is black whatever stands before it.
    rgbe = np.array([[[128, 64, 0, 129], [255, 1, 3, 140]], [[9, 9, 9, 0], [1, 2, 1, 1]]], np.uint8)
    found = decode_rgbe(picture(rgbe.tobytes(), 2, 2))
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, values(rgbe))
    np.testing.assert_array_equal(found[0, 0], [1.0, 0.5, 0.0])
    np.testing.assert_array_equal(found[0, 1], [255 * 16, 16, 48])


def test_old_runs_repeat_a_pixel() -> None:
    body = bytes([10, 20, 30, 130, 1, 1, 1, 3, 5, 6, 7, 131])
    found = decode_rgbe(picture(body, 1, 5))
    expected = np.array([[[10, 20, 30, 130]] * 4 + [[5, 6, 7, 131]]], np.uint8)
    np.testing.assert_array_equal(found, values(expected))
    # A second run counts in units of 256.
    found = decode_rgbe(picture(bytes([10, 20, 30, 130, 1, 1, 1, 2, 1, 1, 1, 1]), 1, 1 + 2 + 256))
    np.testing.assert_array_equal(found, np.broadcast_to(values(expected[0, :1]), (1, 259, 3)))


@pytest.mark.parametrize("width", [8, 130, 300, 1024])
def test_new_runs(width: int) -> None:
    rng = np.random.default_rng(width)
    rgbe = rng.integers(0, 256, (3, width, 4), dtype=np.uint8)
    rgbe[:, width // 4 : 3 * width // 4] = rgbe[:, :1]
    np.testing.assert_array_equal(decode_rgbe(encode(rgbe)), values(rgbe))


@pytest.mark.parametrize(("width", "first"), [(7, 2), (8, 3)])
def test_scanlines_that_only_look_like_runs(width: int, first: int) -> None:
    rgbe = np.full((2, width, 4), 100, np.uint8)
    rgbe[:, 0] = [first, 2, 0, width]
    np.testing.assert_array_equal(decode_rgbe(picture(rgbe.tobytes(), 2, width)), values(rgbe))


def test_orientation_and_exposure() -> None:
    rgbe = np.arange(1, 25, dtype=np.uint8).reshape(2, 3, 4) + 100
    lines = HEADER[:-1] + b"EXPOSURE=2\nEXPOSURE= 4.0\nCOLORCORR= 1 0.5 2\n\n"
    found = decode_rgbe(lines + b"+Y 2 -X 3\n" + rgbe.tobytes())
    np.testing.assert_array_equal(found, (values(rgbe)[::-1, ::-1] / [8, 4, 16]).astype(np.float32))
    # No FORMAT line at all, and a carriage return here and there.
    found = decode_rgbe(b"#?RGBE\r\n\r\n-Y 2 +X 3\n" + rgbe.tobytes())
    np.testing.assert_array_equal(found, values(rgbe))


GOOD = encode(np.random.default_rng(0).integers(0, 256, (4, 16, 4), dtype=np.uint8))


@pytest.mark.parametrize("at", [*range(len(HEADER) + 11, len(GOOD), 17), len(GOOD) - 1])
def test_cut_short_anywhere(at: int) -> None:
    with pytest.raises(InputError, match="cut short"):
        decode_rgbe(GOOD[:at])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"P6 2 2 255\n", "does not begin with '#\\?RADIANCE'"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n", "ends within its header"),
        (HEADER.replace(b"rgbe", b"xyze") + b"-Y 1 +X 2\n", "has format 32-bit_rle_xyze"),
        (HEADER + b"+X 4 -Y 2\n", "resolution line '\\+X 4 -Y 2'"),
        (HEADER + b"-Y 4 +X 2", "resolution line"),
        (HEADER + b"\xff\n", "resolution line"),
        (picture(b"", 0, 2), "is 2 x 0 pixels"),
        (picture(b"", 99999, 2), "is 2 x 99999 pixels"),
        (HEADER[:-1] + b"EXPOSURE=0\n\n-Y 1 +X 2\n", "EXPOSURE=0"),
        (HEADER[:-1] + b"EXPOSURE=many\n\n-Y 1 +X 2\n", "EXPOSURE=many"),
        (picture(bytes([2, 2, 0, 9]) + bytes(64), 1, 8), "has a scanline of 9 pixels; expected 8"),
        (picture(bytes([2, 2, 0, 8, 128 + 9, 0]) + bytes(64), 1, 8), "run that leaves its scanline"),
        (picture(bytes([2, 2, 0, 8, 9]) + bytes(64), 1, 8), "run that leaves its scanline"),
        (picture(bytes([2, 2, 0, 8, 0]) + bytes(64), 1, 8), "run that leaves its scanline"),
        (picture(bytes([1, 1, 1, 2]) * 2, 1, 2), "run that leaves its scanline"),
        (picture(bytes([9, 9, 9, 9, 1, 1, 1, 5]), 1, 2), "run that leaves its scanline"),
    ],
)
def test_damaged_pictures(data: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        decode_rgbe(data)
    assert "\n" not in str(caught.value)


def test_files_name_themselves(tmp_path: Path) -> None:
    cases = {
        "none.hdr": (None, "cannot be read"),
        "empty.hdr": (b"", "is empty"),
        "cut.HDR": (GOOD[:-3], "cut short"),
        "map.tiff": (b"x", "unknown suffix '.tiff'; expected one of .hdr, .exr"),
        "bad.png": (b"not a png", "not a valid .png file"),
        "none.png": (None, "cannot be read"),
    }
    for name, (data, message) in cases.items():
        file = tmp_path / name
        if data is not None:
            file.write_bytes(data)
        with pytest.raises(InputError) as caught:
            read_image(file)
        assert str(caught.value).startswith(f"{file}: ") and message in str(caught.value)
        assert "\n" not in str(caught.value)
    (tmp_path / "folder.hdr").mkdir()
    with pytest.raises(InputError, match="is not a regular file"):
        read_image(tmp_path / "folder.hdr")


def test_hdr_files_are_read(tmp_path: Path) -> None:
    (tmp_path / "map.hdr").write_bytes(GOOD)
    found = read_image(tmp_path / "map.hdr")
    assert found.high_range
    np.testing.assert_array_equal(found.pixels, decode_rgbe(GOOD))


def test_srgb_is_decoded() -> None:
    # IEC 61966-2-1: the ends, the joint of its two pieces, and 0.5 -> 0.2140.
    found = images.srgb_to_linear(np.array([0.0, 0.04045, 0.5, 1.0]))
    np.testing.assert_allclose(found, [0.0, 0.0031308, 0.21404114, 1.0], rtol=2e-5, atol=0)
    assert (np.diff(images.srgb_to_linear(np.linspace(0, 1, 1001))) > 0).all()


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L", "P"])
def test_png(tmp_path: Path, mode: str) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (4, 8, 3), dtype=np.uint8)
    image = Image.fromarray(pixels).convert(mode)
    image.save(tmp_path / "map.png")
    found = read_image(tmp_path / "map.png")
    assert not found.high_range and found.pixels.dtype == np.float32
    expected = images.srgb_to_linear(np.asarray(image.convert("RGB")) / 255.0)
    np.testing.assert_array_equal(found.pixels, expected.astype(np.float32))


def test_deep_grey_png_and_jpeg(tmp_path: Path) -> None:
    deep = np.array([[0, 65535], [32768, 1]], np.uint16)
    Image.fromarray(deep).save(tmp_path / "deep.png")
    found = read_image(tmp_path / "deep.png").pixels
    np.testing.assert_allclose(found[..., 0], images.srgb_to_linear(deep / 65535.0), rtol=1e-6)
    Image.new("RGB", (16, 8), (255, 255, 255)).save(tmp_path / "white.JPG")
    np.testing.assert_array_equal(read_image(tmp_path / "white.JPG").pixels, np.ones((8, 16, 3)))
    data = (tmp_path / "white.JPG").read_bytes()
    (tmp_path / "cut.jpg").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="not a valid"):
        read_image(tmp_path / "cut.jpg")


# ------------------------------------------------------------------------------------------------------ EXR


def fake_package(channels: dict[str, np.ndarray] | Exception) -> types.ModuleType:
    """As much of OpenEXR as is used."""

    class File:
        def __init__(self, name: str, separate_channels: bool) -> None:
            assert separate_channels
            if isinstance(channels, Exception):
                raise channels

        def __enter__(self) -> File:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def channels(self) -> dict[str, types.SimpleNamespace]:
            assert not isinstance(channels, Exception)
            return {name: types.SimpleNamespace(pixels=pixels) for name, pixels in channels.items()}

    module = types.ModuleType("OpenEXR")
    module.File = File  # type: ignore[attr-defined]
    return module


def read_fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: object) -> np.ndarray:
    (tmp_path / "map.exr").write_bytes(b"\x76\x2f\x31\x01")
    monkeypatch.setitem(sys.modules, "OpenEXR", None if content is None else fake_package(content))
    return read_image(tmp_path / "map.exr").pixels


@pytest.mark.parametrize(
    ("names", "taken"),
    [
        ("RGB", "RGB"),
        ("ABGR", "RGB"),
        ("Y", "Y"),
        ("ZY", "Y"),
        (("a.R", "a.G", "a.B", "a.A", "b.Z"), ("a.R", "a.G", "a.B")),
        (("a.R", "a.G", "a.B", "R", "G", "B"), "RGB"),
    ],
)
def test_exr_channels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, names: tuple[str, ...], taken: tuple[str, ...]
) -> None:
    channels = {name: np.full((2, 4), i, np.float16) for i, name in enumerate(names)}
    found = read_fake(tmp_path, monkeypatch, channels)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, np.stack([channels[name] for name in taken], axis=-1))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"needs the OpenEXR package: pip install 'silint\[exr\]'"),
        (RuntimeError("cannot\nread"), "not a valid .exr file, or cut short .cannot read."),
        ({"Z": np.ones((2, 4)), "R": np.ones((2, 4))}, "has channels R, Z; expected R, G, B, or Y"),
        ({}, "has channels none"),
        ({"Y": np.ones((2, 4)), "RY": np.ones((1, 2)), "BY": np.ones((1, 2))}, "luminance and chroma"),
        ({"R": np.ones((2, 4)), "G": np.ones((1, 4)), "B": np.ones((2, 4))}, "has channels B, G, R"),
    ],
)
def test_exr_refusals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: object, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_fake(tmp_path, monkeypatch, content)
    assert "\n" not in str(caught.value)


def test_exr_with_the_package(tmp_path: Path) -> None:
    package = pytest.importorskip("OpenEXR")
    pixels = np.random.default_rng(2).random((4, 8, 3)).astype(np.float16)
    header = {"compression": package.ZIP_COMPRESSION, "type": package.scanlineimage}
    with package.File(header, {"RGB": pixels}) as file:
        file.write(str(tmp_path / "map.exr"))
    np.testing.assert_array_equal(read_image(tmp_path / "map.exr").pixels, pixels.astype(np.float32))
