"""glTF files made by hand, and a reader that shares nothing with silint's."""

from __future__ import annotations

import base64
import json
import struct

import numpy as np

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class File:
    """A document that grows."""

    def __init__(self):
        self.data = b""
        self.document = {
            "asset": {"version": "2.0", "generator": "by hand"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "bufferViews": [],
            "accessors": [],
        }

    def view(self, data, **more):
        self.document["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more}
        )
        self.data += data + b"\0" * (-len(data) % 4)
        return len(self.document["bufferViews"]) - 1

    def accessor(self, values, dtype="f4", stride=0, **more):
        rows = np.ascontiguousarray(values, "<" + dtype)
        rows = rows.reshape(len(rows), -1)
        width = rows.shape[1]
        raw = rows.view(np.uint8).reshape(len(rows), -1)
        if stride:
            raw = np.pad(raw, ((0, 0), (0, stride - raw.shape[1])), constant_values=0xEE)
        view = self.view(raw.tobytes(), **({"byteStride": stride} if stride else {}))
        self.document["accessors"].append(
            {
                "bufferView": view,
                "componentType": COMPONENTS[dtype],
                "count": len(rows),
                "type": KINDS[width],
                **more,
            }
        )
        return len(self.document["accessors"]) - 1

    def positions(self, values):
        values = np.asarray(values, np.float32)
        return self.accessor(values, min=values.min(axis=0).tolist(), max=values.max(axis=0).tolist())

    def mesh(self, *primitives, **more):
        self.document["meshes"].append({"primitives": list(primitives), **more})
        return len(self.document["meshes"]) - 1

    def node(self, **more):
        nodes = self.document["nodes"]
        nodes.append(more)
        self.document["scenes"][0]["nodes"].append(len(nodes) - 1)
        return len(nodes) - 1

    def image(self, data, mime="image/png"):
        """A texture of a picture inside the file."""
        d = self.document
        d.setdefault("images", []).append({"bufferView": self.view(data), "mimeType": mime})
        d.setdefault("textures", []).append({"source": len(d["images"]) - 1})
        return len(d["textures"]) - 1

    def write(self, path):
        document = dict(self.document)
        document["buffers"] = [{"byteLength": len(self.data)}]
        if path.suffix == ".gltf":
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
            document["buffers"][0]["uri"] = uri
            path.write_text(json.dumps(document))
            return path
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        path.write_bytes(
            struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(self.data))
            + struct.pack("<I4s", len(text), b"JSON")
            + text
            + struct.pack("<I4s", len(self.data), b"BIN\0")
            + self.data
        )
        return path


class Read:
    """What stands in a .glb."""

    def __init__(self, path):
        data = path.read_bytes()
        magic, version, total = struct.unpack("<4sII", data[:12])
        assert (magic, version, total) == (b"glTF", 2, len(data))
        size, kind = struct.unpack("<I4s", data[12:20])
        assert kind == b"JSON" and size % 4 == 0
        self.document = json.loads(data[20 : 20 + size])
        length, kind = struct.unpack("<I4s", data[20 + size : 28 + size])
        assert kind == b"BIN\0" and length % 4 == 0 and 28 + size + length == len(data)
        self.binary = data[28 + size :]
        (buffer,) = self.document["buffers"]
        assert buffer["byteLength"] == length and "uri" not in buffer
        for accessor in self.document["accessors"]:
            view = self.document["bufferViews"][accessor["bufferView"]]
            assert (view["byteOffset"] + accessor.get("byteOffset", 0)) % 4 == 0

    def bytes(self, view):
        view = self.document["bufferViews"][view]
        return self.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]

    def values(self, index):
        """(count, width), as stored."""
        accessor = self.document["accessors"][index]
        view = self.document["bufferViews"][accessor["bufferView"]]
        dtype = np.dtype("<" + {v: k for k, v in COMPONENTS.items()}[accessor["componentType"]])
        width = {v: k for k, v in KINDS.items()}[accessor["type"]]
        data = self.bytes(accessor["bufferView"])
        stride = view.get("byteStride", width * dtype.itemsize)
        rows = [
            np.frombuffer(data, dtype, width, accessor.get("byteOffset", 0) + i * stride)
            for i in range(accessor["count"])
        ]
        values = np.stack(rows)
        if "min" in accessor:
            assert values.min(axis=0).tolist() == accessor["min"]
            assert values.max(axis=0).tolist() == accessor["max"]
        return values
