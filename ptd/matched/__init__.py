"""Ground of photogrammetric clouds: one robust height per cell, and a surface of limited curvature.

Dense image matching gives many points. Their heights scatter to both sides and contain
blunders, single ones and clumps, so the lowest point of a cell is a poor estimate of the
ground. The modules work on rasters of cells of 1 m, or 2 m in sparse clouds:

cells
    One robust height per cell.
hull
    Highest surface below the cells that bends down no more than a given curvature.
separable
    The same hull from paraboloids around every cell, computed row by row.
objects
    Large objects: connected surfaces that are surrounded by walls, each classified as a whole.
surface
    Ground surface: hulls of several curvatures, then the mean of the cells near them.
surroundings
    Sums, shares and slopes of the surroundings of each cell.
canopy
    Areas in which crowns hide the ground, and crowns that were classified as ground.
growth
    Growth of the ground up to the edges of terraces and banks.
voting
    Comparison of points with the surface, after a vote of their neighbours.
last_look, decision_trees
    Correction of labels from the surroundings of each point, by decision trees that were fitted
    to known labels.
passes, by_size
    These steps as passes of `ptd.methods.auto.method`, also where cells of 1 m and cells of 2 m
    meet.
place_figures
    Density, noise and size of the cells of each place.
survey, penetration
    Source of a cloud: laser scanning or dense image matching.
robust_cells, facets
    The papers' methods on the same cells, and the comparison of all points with the TIN of the
    ground cells they find.

The passes start from the noise of each place, which is measured on the smoothest patches around
it (`ptd.ground.noise_by_place`).
"""
