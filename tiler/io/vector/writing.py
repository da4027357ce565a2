"""Writing of GeoPackages, which appear when they are complete, with the same bytes for the same features."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from pyproj import CRS

from ptd.arrays import AnyArray
from tiler.core.crs import split
from tiler.errors import ProcessingError, write_error
from tiler.io.atomic_files import atomic_path, cause_of
from tiler.io.vector.opening import journals_of, open_text

WHEN = "2000-01-01T00:00:00.000Z"
"""Fixed time in place of the time of writing, which would change the bytes of each layer."""

VERSION = "1.2"
"""Version of GeoPackage. GDAL before 3.7, as in QGIS 3.22, warns about newer versions whenever
it opens a file."""


class GeoPackage:
    """Open GeoPackage to which layers are added, made by `geopackage`."""

    def __init__(self, path: Path, crs: str | None) -> None:
        self._path = path
        self._crs = crs
        self._layers: set[str] = set()

    def add(
        self,
        layer: str,
        kind: str | None,
        geometries: Sequence[Any] | None,
        columns: Mapping[str, AnyArray],
    ) -> None:
        """Write features. A layer may be written in several calls with the same columns.

        Parameters
        ----------
        layer : str
            Name of the layer.
        kind : str or None
            Type of the geometries: ``Point``, ``LineString`` or ``Polygon``, with ``Multi`` before or `` Z`` after.
            None for a table without geometries.
        geometries : sequence of shapely geometries, or None
            Geometries in units of the CRS, None for a table without geometries.
        columns : mapping of str to arrays
            Columns with a value per geometry. Objects are text.
        """
        from pyogrio import raw

        shapes = None
        if kind is not None and geometries is not None:
            dimensions = 3 if kind.endswith(" Z") else 2
            shapes = np.empty(len(geometries), object)
            shapes[:] = [
                shapely.to_wkb(g, output_dimension=dimensions, flavor="extended")
                for g in geometries
            ]
        with warnings.catch_warnings():
            # GDAL warns about the temporary name, which has another suffix, and about a missing
            # CRS.
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
                crs=None if kind is None else self._crs,
                append=layer in self._layers,
                dataset_options={"VERSION": VERSION},
            )
        self._layers.add(layer)


@contextmanager
def geopackage(path: Path, crs: str | None) -> Iterator[GeoPackage]:
    """Yield a file that is written layer by layer and gets its name once it is complete.

    Parameters
    ----------
    path : Path
    crs : str or None
        WKT or authority code. The file gets the horizontal part, and heights are in units of the vertical part.

    Raises
    ------
    ProcessingError
        The file system refuses a write (see `tiler.errors.write_error`), or a program has the present file open.
    """
    import pyogrio
    from pyogrio.errors import DataLayerError, DataSourceError, FeatureError

    keep = pyogrio.get_gdal_config_option("OGR_CURRENT_DATE")
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": WHEN})
    try:
        with atomic_path(path) as partial:
            # GDAL would add layers to the file of a killed run.
            partial.unlink(missing_ok=True)
            try:
                yield GeoPackage(partial, _horizontal(crs))
            except (DataLayerError, DataSourceError, FeatureError) as error:
                raise write_error(str(path), cause_of(partial, error), path.parent) from error
            if journals := journals_of(path):
                raise ProcessingError(open_text(journals))
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": keep})


def _horizontal(crs: str | None) -> str | None:
    if crs is None:
        return None
    horizontal = split(CRS.from_user_input(crs))[0]
    return None if horizontal is None else horizontal.to_wkt()
