"""A small simulated city with true labels and its true terrain: formulas, solids and a laser scanner.

``terrain`` (a height by formula) and ``objects`` (solids and crowns on it) make a `Scene`; ``sensor`` shoots
rays at it; ``city`` and ``scenes`` build scenes; ``demo`` writes files. Knows nothing of filters, stores or runs.
"""

from tiler.simulate.demo import DemoScene, demo_city
from tiler.simulate.scenes import SCENES, scene_points
from tiler.simulate.sensor import AlsSensor, scan
from tiler.simulate.terrain import Terrain

__all__ = ["SCENES", "AlsSensor", "DemoScene", "Terrain", "demo_city", "scan", "scene_points"]
