"""The classes that the filters give are those of the pipeline: ptd knows nothing of tiler, so both name them."""

from ptd.ground import labelling
from tiler.core import classes


def test_both_name_the_same_classes() -> None:
    for name in ("UNCLASSIFIED", "GROUND", "LOW_NOISE"):
        assert getattr(labelling, name) == getattr(classes, name)
