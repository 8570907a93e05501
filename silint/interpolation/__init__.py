"""Fewer evaluations for the same picture: values at some points of a surface serve those between them.

The points are parted into clusters. Each has *anchors*, from whose values the others' are predicted by moving
least squares, and a *held-back* point: the one farthest from all anchors, computed as well and used for no
prediction. A cluster is left as it is if its held-back point is predicted within half the tolerance and each
of its anchors, from the others, within all of it; else it is halved, its held-back point becomes an anchor,
and each half holds back another, until all is well or all is computed. Nothing is drawn at random, and
nothing depends on the order of the points.

Derivatives by place and normal [WH92; NBMJ14] would let an anchor reach further, but cost more points than
they spare: docs/interpolation.md.
"""

from __future__ import annotations

from silint.interpolation.surfaces import SAME_NORMAL, face_surfaces, smooth_surfaces
from silint.interpolation.values import Interpolated, interpolate

__all__ = ["SAME_NORMAL", "Interpolated", "face_surfaces", "interpolate", "smooth_surfaces"]
