"""Simulated sites with reference classes and terrain, and simulated surveys of them.

A `Site` consists of ``terrain`` (a height by formula) and ``objects`` (solids, crowns, plants, wires), which ``plot``
places on a block of land. ``sites`` contains the kinds of sites by name, and ``catalogue`` the committed scenes.
``als`` simulates laser scanning of a site, with the ``low_points`` of raw scans, and ``dim`` image matching, both
patch by patch. ``cloud`` and ``files`` write the points, and ``demo`` writes the files of the demo. Random numbers come
from a hash of the seed and the index of a patch or block, so results do not depend on an order. This package imports
nothing of filters, stores or runs.
"""

from tiler.simulate.als import AlsSensor
from tiler.simulate.catalogue import SCENES, Scene, SceneSpec, make_scene
from tiler.simulate.demo import DemoScene, demo_city, demo_files
from tiler.simulate.dim import DimSensor
from tiler.simulate.files import WrittenScene, describe_scene, write_scene
from tiler.simulate.points import SimulatedPoints, survey
from tiler.simulate.site import Site
from tiler.simulate.sites import SITES, make_site, scene_points
from tiler.simulate.terrain import Terrain

__all__ = [
    "SCENES",
    "SITES",
    "AlsSensor",
    "DemoScene",
    "DimSensor",
    "Scene",
    "SceneSpec",
    "SimulatedPoints",
    "Site",
    "Terrain",
    "WrittenScene",
    "demo_city",
    "demo_files",
    "describe_scene",
    "make_scene",
    "make_site",
    "scene_points",
    "survey",
    "write_scene",
]  # fmt: skip
