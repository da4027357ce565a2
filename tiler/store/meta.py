"""Frame and lattices of a store, and whether it has colours: fixed when it is made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tiler.core.frame import CoordFrame
from tiler.core.lattice import Lattice
from tiler.errors import ConfigError, StoreError


@dataclass(frozen=True)
class StoreMeta:
    """Everything that the points of a store have in common.

    Attributes
    ----------
    frame : CoordFrame
        What the int32 counts mean.
    bucket : Lattice
        Buckets: the unit of storage; size in counts.
    fine : Lattice
        Cells with one candidate each; their size divides that of a bucket.
    has_rgb : bool
        Whether the points keep their colours, as the method of the first run needs them.

    Raises
    ------
    ConfigError
        A bucket is no whole number of fine cells.
    """

    frame: CoordFrame
    bucket: Lattice
    fine: Lattice
    has_rgb: bool

    def __post_init__(self) -> None:
        cells = self.bucket.size / self.fine.size
        if cells.denominator != 1 or cells < 1:
            raise ConfigError(
                f"buckets of {self.bucket.size} counts are no whole number of cells of {self.fine.size}; "
                "choose a bucket that is a multiple of the candidate cell"
            )

    def to_json(self) -> dict[str, Any]:
        """A JSON-able description, exact; `from_json` reads it back."""
        return {
            "frame": self.frame.to_json(),
            "bucket": self.bucket.to_json(),
            "fine": self.fine.to_json(),
            "has_rgb": self.has_rgb,
        }

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> StoreMeta:
        """The description that `to_json` wrote; StoreError where it is none."""
        try:
            return cls(
                CoordFrame.from_json(data["frame"]),
                Lattice.from_json(data["bucket"]),
                Lattice.from_json(data["fine"]),
                bool(data["has_rgb"]),
            )
        except (KeyError, TypeError, ValueError, ZeroDivisionError, ConfigError) as error:
            raise StoreError(f"its description is damaged ({error}); run again with --overwrite") from error
