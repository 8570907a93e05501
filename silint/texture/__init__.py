"""Textures: a mesh's texture coordinates, a shade point for every texel, and files that viewers show.

=============  =====================================================================================
``bake``       `bake_texture`, from a mesh file to a texture
``charts``     seams and charts of texture coordinates, and what makes them fit for a bake
``unwrap``     texture coordinates for meshes that have none (``xatlas_worker``, in a process of its own)
``slits``      charts cut where they come too close to themselves
``shading``    shading normals at corners, tangents, normal maps
``texels``     texels to shade points, several where a texel holds an edge
``seams``      both sides of a seam made to look alike
``files``      .png, .exr and .glb
``asset``      .glb that keep what a glTF source has
=============  =====================================================================================
"""

from __future__ import annotations

from silint.texture.bake import SUFFIXES, bake_texture

__all__ = ["SUFFIXES", "bake_texture"]
