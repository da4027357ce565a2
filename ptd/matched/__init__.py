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
canopy
    where crowns hide the ground, and where they were taken for it.
growth
    ground up to the edges of terraces and banks.
voting
    points against the surface; neighbours vote.
last_look, trees
    what lies around a point decides whether its label stays, by trees that were fitted to known labels.
passes, by_side
    all of it as passes of `ptd.methods.auto.method`; where cells of two sides meet.
place_figures
    what these start from at a place: density, noise, side of the cells.
survey, penetration
    what made a cloud: a laser scanner, or matching.
robust_cells, facets
    the papers' methods on the same cells, and all points against the TIN of the cells that these take for ground.

The noise of a place that they start from is that of what is smoothest around it (`ptd.ground.noise_by_place`).
"""
