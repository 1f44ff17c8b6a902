"""Large pictures: lights from some of the pixels, then all pixels tile by tile.

What a fit holds beside the pictures is a few hundred bytes a pixel, and for a large picture that is
more than the pictures themselves. But lights have few unknowns: a strided subset of the pixels
finds them as well as all do. Once they are known pixels touch each other only where normals are
refined. So

1. every s-th row and column is a small scene (`windows`), which is fitted as any other: lights,
   whether normals are to be refined, the material prior and its offsets;
2. with all of this held, tiles of the picture are fitted one after the other. Where normals are
   refined they have a margin, which is not kept.

Only the pictures and the resulting maps are there as a whole.
"""

from pbrfit.fit.tiles.fit import fit_tiles

__all__ = ["fit_tiles"]
