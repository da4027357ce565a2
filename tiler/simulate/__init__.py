"""Simulated sites with reference classes and terrain, and simulated surveys of them.

A `Site` consists of ``terrain`` (a height by formula) and ``objects`` (solids, crowns, plants, wires), which
``blocks`` places on its plots. ``sites`` and ``water_sites`` contain the kinds of sites by name, and ``catalogue`` the
committed scenes. ``als`` simulates laser scanning of a site, and ``dim`` image matching of its ``matched_surface``,
both patch by patch. ``files`` writes the points, also those of the demo. Random numbers come from a hash of the seed
and the index of a patch or block, so results do not depend on an order. This package imports nothing of filters, stores
or runs.
"""

from tiler.simulate.als import AlsSensor
from tiler.simulate.catalogue import SCENES, make_scene
from tiler.simulate.dim import DimSensor
from tiler.simulate.files import DemoScene, demo_city, demo_files, describe_scene, write_scene
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
    "SimulatedPoints",
    "Site",
    "Terrain",
    "demo_city",
    "demo_files",
    "describe_scene",
    "make_scene",
    "make_site",
    "scene_points",
    "survey",
    "write_scene",
]  # fmt: skip
