"""Vector files that people get: GeoPackages that appear whole, with the same bytes for the same features."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely
from pyproj import CRS

from tiler.core.crs import split
from tiler.errors import refused_write
from tiler.io.partial_files import appearing

WHEN = "2000-01-01T00:00:00.000Z"
"""In place of the time of writing, which a GeoPackage keeps for each layer: same features, same bytes."""

VERSION = "1.2"
"""Of GeoPackage: GDAL below 3.7, as in QGIS 3.22, warns of newer ones each time it opens a file."""


class GeoPackage:
    """Takes the layers of an open file; made by `geopackage`."""

    def __init__(self, path: Path, crs: str | None) -> None:
        self._path = path
        self._crs = crs
        self._layers: set[str] = set()

    def add(
        self, layer: str, kind: str, geometries: Sequence[Any], columns: Mapping[str, npt.NDArray[Any]]
    ) -> None:
        """Write features; a layer may be written in several calls with the same columns.

        Parameters
        ----------
        layer : str
        kind : str
            Type of the geometries: ``Point``, ``LineString``, ``Polygon``, with ``Multi`` or `` Z`` where they are.
        geometries : sequence of shapely geometries
            In units of the CRS.
        columns : mapping of str to arrays
            A value for each geometry; objects are text.
        """
        from pyogrio import raw

        dimensions = 3 if kind.endswith(" Z") else 2
        shapes = np.empty(len(geometries), object)
        shapes[:] = [shapely.to_wkb(g, output_dimension=dimensions, flavor="extended") for g in geometries]
        with warnings.catch_warnings():
            # Until the file is whole its name does not end as that of a GeoPackage should; without a CRS there is none.
            warnings.simplefilter("ignore", RuntimeWarning)
            warnings.simplefilter("ignore", UserWarning)
            raw.write(
                self._path,
                shapes,
                list(columns.values()),
                list(columns),
                layer=layer,
                driver="GPKG",
                geometry_type=kind,
                crs=self._crs,
                append=layer in self._layers,
                dataset_options={"VERSION": VERSION},
            )
        self._layers.add(layer)


@contextmanager
def geopackage(path: Path, crs: str | None) -> Iterator[GeoPackage]:
    """A file that is written layer by layer and has its name once it is whole.

    Parameters
    ----------
    path : Path
    crs : str or None
        WKT or authority code; its horizontal part alone is kept, and heights are in units of the vertical one.

    Raises
    ------
    ProcessingError
        The disk refuses; see `tiler.errors.refused_write`.
    """
    import pyogrio
    from pyogrio.errors import DataLayerError, DataSourceError, FeatureError

    keep = pyogrio.get_gdal_config_option("OGR_CURRENT_DATE")
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": WHEN})
    try:
        with appearing(path) as partial:
            partial.unlink(missing_ok=True)  # of a run that was killed: GDAL would add to it
            yield GeoPackage(partial, _horizontal(crs))
    except (DataLayerError, DataSourceError, FeatureError) as error:
        raise refused_write(str(path), error, path.parent) from error
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": keep})


def _horizontal(crs: str | None) -> str | None:
    if crs is None:
        return None
    horizontal = split(CRS.from_user_input(crs))[0]
    return None if horizontal is None else horizontal.to_wkt()
