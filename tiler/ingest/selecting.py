"""Selection of the points for the filter and the rasters, see `tiler.core.selection`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tiler.core.selection import (
    FIRST,
    LAST,
    MAX_RETURNS,
    MAX_SOURCE_ID,
    Selection,
    parse_numbers,
)

Bools = npt.NDArray[np.bool_]


def unselected(
    selection: Selection,
    returns: npt.NDArray[np.uint8],
    angles_deg: npt.NDArray[np.float32],
    source_ids: npt.NDArray[np.uint16],
    classes: npt.NDArray[np.uint8],
) -> dict[str, Bools]:
    """Return masks of the points that each option of a selection leaves out.

    Parameters
    ----------
    selection : Selection
    returns : uint8 (2, n)
        Return number, and number of returns of the pulse. A number of 0 counts as 1.
    angles_deg : float32 (n,)
        Scan angles in degrees.
    source_ids : uint16 (n,)
    classes : uint8 (n,)

    Returns
    -------
    dict of str to bool (n,)
        Mask by the key of `Selection.options`.
    """
    masks: dict[str, Bools] = {}
    if selection.returns is not None:
        masks["returns"] = ~_of_returns(selection.returns, np.maximum(returns, 1))
    if selection.scan_angle_deg is not None:
        masks["scan_angle"] = np.abs(angles_deg) > selection.scan_angle_deg
    if selection.source_ids is not None:
        selected_ids = parse_numbers(selection.source_ids, "point source ids", 0, MAX_SOURCE_ID)
        masks["source_id"] = ~np.isin(source_ids, selected_ids)
    if selection.drop_classes:
        masks["drop_classes"] = np.isin(classes, selection.drop_classes)
    return masks


def _of_returns(wanted: str, returns: npt.NDArray[np.uint8]) -> Bools:
    number, of = returns
    if wanted == LAST:
        return np.asarray(number >= of)
    if wanted == FIRST:
        return np.asarray(number == 1)
    return np.isin(number, parse_numbers(wanted, "returns", 1, MAX_RETURNS))
