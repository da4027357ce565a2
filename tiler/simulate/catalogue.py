"""Scenes on which methods are tuned and scored: names, seeds and sensors.

The scenes were committed before any tuning. Scores of different dates are comparable only if
the scenes stay the same. Add scenes rather than change one, and document every change.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.arrays import Float64, UInt8, UInt16
from tiler.errors import ConfigError
from tiler.simulate.als import AlsSensor
from tiler.simulate.dim import DimSensor
from tiler.simulate.points import Sensor, survey
from tiler.simulate.site import Site
from tiler.simulate.sites import SITES

SENSORS: dict[str, type[AlsSensor] | type[DimSensor]] = {"als": AlsSensor, "dim": DimSensor}


@dataclass(frozen=True)
class SceneSpec:
    """Description of a scene.

    Attributes
    ----------
    name : str
    kind : str
        ``als`` or ``dim``.
    summary : str
    scene_class : str
        Class of the scene. Scenes of one class are scored together.
    site : str
        A name of `tiler.simulate.sites.SITES`.
    seed : int
    side_m : float
    sensor : mapping
        Settings of the kind's sensor that differ from its defaults.
    """

    name: str
    kind: str
    summary: str
    scene_class: str
    site: str
    seed: int
    side_m: float
    sensor: Mapping[str, Any] = field(default_factory=dict)

    def make_site(self) -> Site:
        """Make the terrain and the objects of the scene."""
        return SITES[self.site](self.seed, self.side_m)

    def make_sensor(self) -> Sensor:
        """Make the sensor of the scene."""
        return SENSORS[self.kind](**self.sensor)


@dataclass(frozen=True)
class Scene:
    """Simulated cloud with its reference classes and terrain.

    Attributes
    ----------
    spec : SceneSpec
    site : Site
    xyz : float64, shape (n, 3)
        Coordinates in metres from the scene's south-west corner, rounded to millimetres.
    classification : uint8, shape (n,)
        Reference classes (ASPRS), as `tiler.simulate.points.SimulatedPoints.label`.
    rgb : uint16, shape (n, 3), or None
    returns : uint8, shape (n, 2)
        Return number and number of returns.
    """

    spec: SceneSpec
    site: Site
    xyz: Float64
    classification: UInt8
    rgb: UInt16 | None
    returns: UInt8

    def truth(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Float64:
        """Return the reference height of the ground in metres, float64 of the broadcast shape."""
        return self.site.terrain.height_at(x, y)


ROUGH = {"textureless_share": 0.1, "plants_m": 0.3}
"""Settings for patches without texture, and low plants as ground, as in real clouds."""

_ALL = (
    SceneSpec("als_city", "als", "flats, courtyards, podiums, parking, parks, a dam, a power line",
              "als city", "city", 101, 260.0, {"density": 4.0}),
    SceneSpec("als_city_dense", "als", "another city at 15 points/m2", "als city", "city", 102, 160.0,
              {"density": 15.0, "sigma_m": 0.02}),
    SceneSpec("als_suburb", "als", "houses, hedges, walls, gardens, a cutting with a bridge, a pond",
              "als suburb", "suburb", 111, 260.0, {"density": 4.0}),
    SceneSpec("als_suburb_sparse", "als", "a suburb at 1 point/m2", "als suburb", "suburb", 112, 300.0,
              {"density": 1.0, "sigma_m": 0.03}),
    SceneSpec("als_forest", "als", "closed wood with undergrowth on hills, a stream, clearings",
              "als forest", "forest", 121, 200.0, {"density": 5.0}),
    SceneSpec("als_mountain", "als", "sharp ridges beside a valley with a settlement", "als mountain", "mountain",
              131, 300.0, {"density": 2.0, "sigma_m": 0.03}),
    SceneSpec("als_mountain_dense", "als", "other ridges and another settlement, 6 points/m2", "als mountain",
              "mountain", 132, 260.0, {"density": 6.0}),
    SceneSpec("als_terraces", "als", "vineyard terraces below a cliff, retaining and garden walls",
              "als breaklines", "terraces", 141, 240.0, {"density": 4.0}),
    SceneSpec("als_quarry", "als", "a pit with benches, spoil heap, railway embankment, works", "als breaklines",
              "quarry", 142, 260.0, {"density": 3.0}),
    SceneSpec("als_river", "als", "a river and a pond that return hardly anything, two bridges, houses",
              "als river", "river", 151, 280.0, {"density": 3.0}),
    SceneSpec("als_halls", "als", "halls of up to 95 x 65 m, podiums, large courtyards", "als halls", "halls",
              161, 300.0, {"density": 3.0}),
    SceneSpec("als_sparse", "als", "houses, fields and wood on hills at 0.5 points/m2", "als sparse", "mixed",
              171, 300.0, {"density": 0.5, "sigma_m": 0.03}),
    SceneSpec("dim_city", "dim", "coloured city with facades, streets, parks", "dim city", "city", 201, 120.0,
              {"density": 30.0, "facade": 0.4}),
    SceneSpec("dim_halls", "dim", "coloured halls, podiums and large courtyards with facades", "dim city", "halls",
              202, 150.0, {"density": 20.0, "facade": 0.4}),
    SceneSpec("dim_village", "dim", "houses and gardens on a slope of 15 degrees, fields, a gully, terraces",
              "dim village", "village", 211, 120.0, {"density": 40.0}),
    SceneSpec("dim_park", "dim", "lawns, meadows, groups of trees, a pond, 80 points/m2", "dim park", "park",
              221, 100.0, {"density": 80.0, "sigma_m": 0.05}),
    SceneSpec("dim_area_city", "dim", "a city at 40 points/m2, sigma 0.066, blunders 0.05 %", "dim area", "city",
              231, 120.0),
    SceneSpec("dim_area_suburb", "dim", "a suburb at 40 points/m2, sigma 0.066, blunders 0.05 %", "dim area",
              "suburb", 232, 120.0),
    SceneSpec("als_village", "als", "houses and dug-in garages on a slope of 15 degrees, fields, a gully",
              "als village", "village", 181, 200.0, {"density": 5.0}),
    SceneSpec("als_park", "als", "meadows, hedges, groups of trees at 10 points/m2", "als park", "park",
              182, 180.0, {"density": 10.0, "sigma_m": 0.02}),
    SceneSpec("dim_mountain", "dim", "wooded ridges and a settlement, hardly any ground seen below the wood",
              "dim mountain", "mountain", 241, 180.0, {"density": 15.0}),
    SceneSpec("dim_drone", "dim", "a suburb photographed from a drone: 80 points/m2, sigma 0.02, sharper edges",
              "dim drone", "suburb", 242, 100.0, {"density": 80.0, "sigma_m": 0.02, "edge_m": 0.15}),
    SceneSpec("dim_rows", "dim", "terraced houses cut by the border, gardens, sheds, a canal; 60 points/m2", "dim rows",
              "rows", 251, 120.0, ROUGH | {"density": 60.0, "tails": 4.0, "shadow": 2.0, "edge_m": 0.4}),
    SceneSpec("dim_industry", "dim", "halls of 90 x 50 m cut by the border, trailers; a mesh's smooth errors of 0.12 m",
              "dim industry", "industry", 257, 250.0,
              ROUGH | {"density": 10.0, "sigma_m": 0.12, "correlated": 1.0, "edge_m": 0.6, "facade": 0.0,
                       "jitter": 0.2, "shadow": 2.0}),
    SceneSpec("dim_houses", "dim", "houses below and between trees, 2.5 times the noise in shadow", "dim houses",
              "suburb", 253, 130.0,
              ROUGH | {"density": 38.0, "sigma_m": 0.12, "tails": 4.0, "shadow": 2.5, "edge_m": 0.5}),
    SceneSpec("dim_sparse", "dim", "houses and gardens at 8 points/m2 with 0.2 m of noise", "dim sparse",
              "suburb", 254, 200.0,
              ROUGH | {"density": 8.0, "sigma_m": 0.2, "correlated": 0.05, "tails": 3.5, "shadow": 2.0, "facade": 0.0,
                       "edge_m": 0.6, "blunders": 2e-3}),
    SceneSpec("dim_bluff", "dim", "a closed wood of 16 to 20 m on a bluff of 60 m, cut by the border", "dim bluff",
              "bluff", 255, 200.0,
              ROUGH | {"density": 8.0, "sigma_m": 0.12, "correlated": 0.65, "correlation_m": 3.0, "tails": 4.0,
                       "shadow": 3.0, "facade": 0.0, "edge_m": 0.7, "blunders": 1e-3}),
    SceneSpec("dim_forest", "dim", "a closed wood with few glimpses of the ground, no colours", "dim forest", "forest",
              256, 150.0,
              ROUGH | {"density": 25.0, "tails": 4.0, "shadow": 3.0, "edge_m": 0.6, "facade": 0.0,
                       "coloured": False}),
    SceneSpec("als_weir", "als", "a pool above a dam of 3 m, tailwater with waves, a tributary, trees over both banks",
              "als water", "weir", 261, 700.0, {"density": 3.0}),
    SceneSpec("als_meander", "als", "a river that falls 1 m per km, a bar, a gravel island, a ford, a bridge",
              "als water", "meander", 262, 1500.0, {"density": 2.0}),
    SceneSpec("als_canal", "als", "a canal between quays, trees far over the water, houses beside it",
              "als water", "canal", 266, 240.0, {"density": 8.0}),
    SceneSpec("als_lakes", "als", "three lakes with a dam between two, a bank of reed, two strips that differ by 0.4 m",
              "als water", "lakes", 263, 640.0, {"density": 2.0}),
    SceneSpec("als_tide", "als", "a beach and a sea at two tides", "als water", "tide", 264, 400.0, {"density": 2.0}),
    SceneSpec("als_wet_meadow", "als", "flat land with few returns in patches, no water", "als water", "wet_meadow",
              265, 400.0, {"density": 2.0}),
    SceneSpec("raw_suburb", "als", "a suburb, 0.02 % of the points below the ground, of every depth", "als raw",
              "suburb", 271, 200.0, {"density": 8.0, "low_share": 2e-4}),
    SceneSpec("raw_hills", "als", "houses, fields and wood on hills, 0.15 % of the points below the ground", "als raw",
              "mixed", 272, 200.0, {"density": 6.0, "low_share": 1.5e-3}),
    SceneSpec("raw_clumps", "als", "meadows and groups of trees, clumps of 8 to 30 low points", "als raw", "park", 273,
              180.0, {"density": 8.0, "low_clumps_km2": 600.0}),
    SceneSpec("raw_mirror", "als", "a city whose streets are mirrored 3 to 5 m below the ground in places", "als raw",
              "city", 287, 200.0, {"density": 8.0, "mirrors_km2": 60.0}),
    SceneSpec("raw_forest", "als", "closed wood on hills, 0.05 % of the points below the ground", "als raw", "forest",
              275, 160.0, {"density": 6.0, "low_share": 5e-4}),
)  # fmt: skip

SCENES: dict[str, SceneSpec] = {spec.name: spec for spec in _ALL}
"""Scenes by name."""


def make_scene(name: str) -> Scene:
    """Simulate a scene. The same name gives the same points.

    Parameters
    ----------
    name : str
        A name of `SCENES`.

    Raises
    ------
    ConfigError
        If no scene has this name.
    """
    if name not in SCENES:
        raise ConfigError(f"unknown scene {name!r}: choose one of {', '.join(SCENES)}")
    spec = SCENES[name]
    site = spec.make_site()
    points = survey(site, spec.make_sensor())
    returns = np.column_stack((points.number, points.count))
    return Scene(spec, site, points.xyz, points.label, points.rgb, returns)
