"""Clouds of the simulated scenes of water, as files whose classes hide the truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tiler.simulate.catalogue import SCENES, SceneSpec
from tiler.simulate.files import CloudWriter
from tiler.simulate.points import survey

UNCLASSIFIED, GROUND, WATER = 1, 2, 9
PLANTS_AND_NOISE = (3, 4, 5, 7, 18)

WATER_SCENES = [name for name, spec in SCENES.items() if spec.scene_class == "als water"]
"""Names of the scenes."""

UNKNOWN = dict.fromkeys(range(256), UNCLASSIFIED)
WATER_KNOWN = UNKNOWN | {WATER: WATER}
BARE = dict.fromkeys(range(256), GROUND) | {value: value for value in PLANTS_AND_NOISE}
"""Classes by true class: everything but plants and noise is ground, so no filter is needed."""


def write_cloud(path: Path, spec: SceneSpec, classes: Mapping[int, int] = UNKNOWN) -> Path:
    """Write the points of a scene; ``classes`` has the class of the file for each true class."""
    points = survey(spec.make_site(), spec.make_sensor())
    table = np.array([classes[value] for value in range(256)], np.uint8)
    with CloudWriter(path) as cloud:
        cloud.write(points, table[points.label])
    return path
