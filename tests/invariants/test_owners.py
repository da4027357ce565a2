"""Each point has one owner and one label."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np

from tests.invariants.runs import rows_of, stored_labels, the_store


def test_each_row_of_each_file_lies_in_one_bucket(
    finished: Path, quarter_files: list[Path]
) -> None:
    store, found = the_store(finished), []
    for cell, info in store.buckets().items():
        block = store.read_bucket(cell, ("xyz", "origin"))
        assert block.origin is not None
        assert len(block) == info.n
        absolute = (
            block.xyz[:2].astype(np.int64) + np.array(store.meta.frame.origin)[:, np.newaxis]
        )
        assert set(store.meta.bucket.index(absolute[0])) == {cell.ix}
        assert set(store.meta.bucket.index(absolute[1])) == {cell.iy}
        found += rows_of(block.origin)
    expected = []
    for path in quarter_files:
        number = store.get_state("sources")[str(path.resolve())]["number"]
        with laspy.open(path) as reader:
            expected += [(number, row) for row in range(reader.header.point_count)]
    assert sorted(found) == sorted(expected)


def test_the_label_of_a_point_is_the_class_in_its_file(
    finished: Path, quarter_files: list[Path]
) -> None:
    labels, _ = stored_labels(finished)
    numbers = the_store(finished).get_state("sources")
    in_order = sorted(quarter_files, key=lambda path: numbers[str(path.resolve())]["number"])
    written = [
        np.asarray(laspy.read(finished / "classified" / p.name).classification)
        for p in in_order
    ]
    assert np.array_equal(labels, np.concatenate(written))
    assert set(labels.tolist()) <= {1, 2, 7}


def test_classified_files_keep_order_and_all_other_fields(
    finished: Path, quarter_files: list[Path]
) -> None:
    for path in quarter_files:
        before, after = laspy.read(path), laspy.read(finished / "classified" / path.name)
        for name in before.points.array.dtype.names:
            if name != "classification":
                assert np.array_equal(before.points.array[name], after.points.array[name]), name
        assert [v.record_data_bytes() for v in before.vlrs] == [
            v.record_data_bytes() for v in after.vlrs
        ]
