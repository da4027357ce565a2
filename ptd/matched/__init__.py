"""Ground of matched clouds (photogrammetry): one robust height per cell, and a surface that may bend only so much.

Image matching gives dense clouds whose heights scatter to both sides and hold blunders, alone and in clumps, so the
lowest point of a cell says little. Every module here works on rasters of cells of 1 m, 2 m in sparse clouds:

cells
    one robust height per cell.
hull
    the highest surface below the cells that bends down no more than a given curvature.
separable
    the same for paraboloids around every cell, row by row.
objects
    connected surfaces with walls around them are objects, as a whole.
surface
    hulls of several curvatures, and the mean of the cells that lie about them.
surroundings
    what lies around each cell: sums, shares and slopes.
growth
    ground up to the edges of terraces and banks.
voting
    points against the surface; neighbours vote.
passes
    all of it as passes of `ptd.methods.auto.method`.
survey, penetration
    what made a cloud: a laser scanner, or matching.
on_cells, facets
    the papers' methods on the same cells, and all points against the TIN of the cells that these take for ground.

The noise of the run that they start from is that of the smoothest places (`ptd.ground.roughness`, ``smoothest_m``).
"""
