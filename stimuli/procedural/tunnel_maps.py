"""The tunnel of `tunnel_geom` with textures: a checkerboard, noise, and a stretch without vertex normals (flat)."""

from __future__ import annotations

import numpy as np

from stimuli.procedural.shapes import Mesh, checkerboard, generator, matte, noise, part, recipe_sha256
from stimuli.procedural.tunnel_geom import DURATION_S, RINGS, SEGMENTS, flight, tunnel
from stimuli.scene import Light, Scene

VERSION = 2


def build() -> Scene:
    """The scene: bands of ten rings alternate between the two textures; the last third is flat-shaded."""
    whole = tunnel()
    rng = generator("tunnel_maps")
    tiles = matte("tiles", (1.0, 1.0, 1.0), checkerboard(256, 8, (0.16, 0.14, 0.2), (0.85, 0.8, 0.7)))
    rock = matte("rock", (1.0, 1.0, 1.0), noise(rng, 256, (0.1, 0.2, 0.15), (0.9, 0.85, 0.75)))
    cells = RINGS * SEGMENTS
    ring = np.tile(np.arange(cells) // SEGMENTS, 2)
    band, far = ring // 10 % 2, ring >= RINGS * 2 // 3
    parts = []
    for name, material, chosen in (("tiles", tiles, band == 0), ("rock", rock, band == 1)):
        for flat in (False, True):
            faces = whole.indices[chosen & (far == flat)]
            used, renumbered = np.unique(faces, return_inverse=True)
            piece = Mesh(
                whole.positions[used], whole.normals[used], whole.uv[used], renumbered.reshape(-1, 3).astype(np.int64)
            )
            parts.append(part(f"{name} {'flat' if flat else 'smooth'}", piece, material, flat=flat))
    return Scene(
        name="tunnel_maps",
        static=tuple(parts),
        movers=(),
        lights=(Light("point", (1.05, 1.0, 0.9), (0.4, 0.9, -4.0), falloff="none", name="lamp"),),
        camera=flight("flight"),
        sha256=recipe_sha256("tunnel_maps", VERSION),
        ambient=(0.02, 0.02, 0.02),
        duration_s=DURATION_S,
    )
