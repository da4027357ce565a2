"""Scenes of the scorecard: clouds in metres with a true class for each point, real ones and simulated ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

VIRTUAL = 66
"""A producer's points that nobody measured: they are no part of a scene."""

ISPRS_SAMPLES = "ISPRS samples"
OTHER_REAL = "other real clouds"
SIMULATED = {"als": "simulated laser scanning", "dim": "simulated image matching"}

ISPRS = ("11", "12", "22", "24", "31", "42", "51", "53")


@dataclass(frozen=True)
class Cloud:
    """What a filter may see, and the truth.

    Attributes
    ----------
    xyz : float64 [n, 3]
        Metres.
    classification : uint8 [n]
        True classes, ASPRS.
    rgb : uint16 [n, 3] or None
    returns : uint8 [n, 2] or None
        Return number and number of returns.
    truth : callable or None
        True height of the ground at x, y, metres; for scenes from (0, 0) to (side_m, side_m).
    side_m : float
    """

    xyz: np.ndarray
    classification: np.ndarray
    rgb: np.ndarray | None = None
    returns: np.ndarray | None = None
    truth: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    side_m: float = 0.0


@dataclass(frozen=True)
class BenchScene:
    """A scene by name; `load` reads or makes it.

    Scenes of a family are averaged, those of a group stand in one table.
    """

    name: str
    family: str
    group: str
    load: Callable[[], Cloud]


def read_clouds(paths: Sequence[Path]) -> Cloud:
    """The points of LAZ files as one cloud, without those that are virtual."""
    import laspy

    parts = [laspy.read(path) for path in paths]
    xyz = np.concatenate([np.asarray(part.xyz) for part in parts])
    classes = np.concatenate([np.asarray(part.classification, np.uint8) for part in parts])
    returns = np.concatenate([
        np.stack((np.asarray(p.return_number), np.asarray(p.number_of_returns)), axis=1) for p in parts
    ]).astype(np.uint8)  # fmt: skip
    rgb = None
    if all("red" in part.point_format.dimension_names for part in parts):
        rgb = np.concatenate(
            [np.stack([np.asarray(p[c]) for c in ("red", "green", "blue")], axis=1) for p in parts]
        )
    measured = classes != VIRTUAL
    return Cloud(
        xyz[measured],
        classes[measured],
        rgb[measured] if rgb is not None and rgb.any() else None,
        returns[measured] if returns.any() else None,
    )


def real_scenes(data: Path) -> Iterator[BenchScene]:
    """The labelled clouds of a folder of real data; nothing of what is not there."""
    found = [(ISPRS_SAMPLES, f"samp{n}", [data / f"isprs/samp{n}-utm.laz"]) for n in ISPRS]
    found += [
        ("other laser scanning", "AHN3 row houses", [data / "ahn3/ahn3_cropped_2.laz"]),
        ("other laser scanning", "IGN six tiles", sorted((data / "ign/tiles50m").glob("*.laz"))),
        ("other laser scanning", "IGN buildings", [data / "ign/bat.laz"]),
        ("other laser scanning", "IGN crop 1", [data / "ign/crop_1.laz"]),
        ("other laser scanning", "IGN crop 3", [data / "ign/crop_3.laz"]),
        ("other laser scanning", "IGN town, thinned", [data / "ign/test_semis_2023_0292_6833.laz"]),
        ("image matching", "Brighton park", [data / "dim/brighton_east.laz"]),
    ]
    for family, name, paths in found:
        if paths and all(path.is_file() for path in paths):
            group = family if family == ISPRS_SAMPLES else OTHER_REAL
            yield BenchScene(name, family, group, partial(read_clouds, paths))


def simulated_scenes() -> Iterator[BenchScene]:
    """The scenes of the simulator's catalogue."""
    from tiler.simulate.catalogue import SCENES

    for name, spec in SCENES.items():
        yield BenchScene(
            name, f"simulated {spec.scene_class}", SIMULATED[spec.kind], partial(simulated, name)
        )


def simulated(name: str) -> Cloud:
    """A scene of the simulator."""
    from tiler.simulate.catalogue import make_scene

    scene = make_scene(name)
    return Cloud(scene.xyz, scene.classification, scene.rgb, scene.returns, scene.truth, scene.spec.side_m)
