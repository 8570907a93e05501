"""Bake the ambient occlusion of a .glb with Blender's Cycles on all cores; run by texture.py.

    PYTHON blender_bake.py MESH.glb OUT.exr SIZE SAMPLES

Prints Blender's version and the seconds of the bake itself as JSON. The first bake, of one sample, is not
timed: it builds what the second uses.
"""

from __future__ import annotations

import json
import sys
import time

import bpy

mesh, out, size, samples = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=mesh)
scene = bpy.context.scene
scene.render.engine = "CYCLES"
scene.cycles.device = "CPU"
scene.cycles.use_adaptive_sampling = False
scene.cycles.use_denoising = False
scene.world = bpy.data.worlds.new("world")
scene.world.light_settings.distance = 1e6  # no limit

image = bpy.data.images.new("bake", size, size, float_buffer=True)
image.colorspace_settings.name = "Non-Color"
shape = next(o for o in scene.objects if o.type == "MESH")
material = bpy.data.materials.new("bake")
material.use_nodes = True
node = material.node_tree.nodes.new("ShaderNodeTexImage")
node.image = image
material.node_tree.nodes.active = node
shape.data.materials.clear()
shape.data.materials.append(material)
bpy.context.view_layer.objects.active = shape
shape.select_set(True)
for n in (1, samples):
    scene.cycles.samples = n
    began = time.perf_counter()
    bpy.ops.object.bake(type="AO", margin=4, use_clear=True)
    seconds = time.perf_counter() - began

image.filepath_raw = out
image.file_format = "OPEN_EXR"
image.save()
print(json.dumps({"version": bpy.app.version_string, "seconds": seconds}))
