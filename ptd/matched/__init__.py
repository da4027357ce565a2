"""Ground of photogrammetric clouds: one robust height per cell, and a surface of limited curvature.

Dense image matching gives many points. Their heights scatter to both sides and contain
blunders, single ones and clumps, so the lowest point of a cell is a poor estimate of the
ground. The modules work on rasters of cells of 1 m, or 2 m in sparse clouds:

evidence, penetration, survey
    Source of a cloud (laser scanning or dense image matching), and the density, noise and cell
    size of each place.
cells
    One robust height per cell.
hull, bent_hull
    Highest surface below the cells that bends down no more than a given curvature, and a hull
    that bends as much as the cells show.
objects
    Large objects (connected surfaces that are surrounded by walls, each classified as a whole)
    and islands of ground on them.
surface, growth
    Ground surface: hulls of several curvatures, then the mean of the cells near them, and the
    growth of the ground up to the edges of terraces and banks.
canopy, crowns
    Areas in which crowns hide the ground, crowns that were classified as ground, heights of
    trees.
ground_model, last_look
    Comparison of points with the surface after a vote of their neighbours, and correction of
    labels from the surroundings of each point by decision trees.
step, passes
    These steps as passes of `ptd.methods.auto.method`, also where cells of 1 m and cells of 2 m
    meet.
robust_cells
    The papers' methods on the same cells, and the comparison of all points with the TIN of the
    ground cells they find.

The passes start from the noise of each place, which is measured on the smoothest patches around
it (`ptd.ground.noise_sums`).
"""
