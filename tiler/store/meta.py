"""Properties that are fixed when a store is made: its frame, its lattices, and whether points have colours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tiler.core.frame import CoordFrame
from tiler.core.lattice import Lattice
from tiler.errors import ConfigError, StoreError


@dataclass(frozen=True)
class StoreMeta:
    """Properties that all points of a store share.

    Attributes
    ----------
    frame : CoordFrame
        Frame that gives the int32 counts their meaning.
    bucket : Lattice
        Lattice of the buckets, the units of storage. Its size is in counts.
    fine : Lattice
        Lattice of the cells with one candidate each. Its size divides the size of a bucket.
    has_rgb : bool
        Whether the points keep their colours, which is the case if the method of the first run uses colours.

    Raises
    ------
    ConfigError
        The size of a bucket is not a multiple of the size of a fine cell.
    """

    frame: CoordFrame
    bucket: Lattice
    fine: Lattice
    has_rgb: bool

    def __post_init__(self) -> None:
        cells = self.bucket.size / self.fine.size
        if cells.denominator != 1 or cells < 1:
            raise ConfigError(
                f"bucket size {self.bucket.size} is not a multiple of the candidate cell {self.fine.size} (in counts); "
                "use a bucket size that is a multiple of the candidate cell"
            )

    def to_json(self) -> dict[str, Any]:
        """Return an exact JSON-able description, which `from_json` reads."""
        return {
            "frame": self.frame.to_json(),
            "bucket": self.bucket.to_json(),
            "fine": self.fine.to_json(),
            "has_rgb": self.has_rgb,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> StoreMeta:
        """Read the description that `to_json` wrote. Raise StoreError if it is damaged."""
        try:
            return cls(
                frame=CoordFrame.from_json(data["frame"]),
                bucket=Lattice.from_json(data["bucket"]),
                fine=Lattice.from_json(data["fine"]),
                has_rgb=bool(data["has_rgb"]),
            )
        except (KeyError, TypeError, ValueError, ZeroDivisionError, ConfigError) as error:
            raise StoreError(
                f"its description is damaged ({error}); run again with --overwrite"
            ) from error
