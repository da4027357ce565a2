"""A small text file, written whole or not at all."""

from __future__ import annotations

import os
from typing import Any

from tiler.errors import refused_write
from tiler.export.work import WriteText
from tiler.io.cloud_reading import digest_of_file
from tiler.io.locations import cloud_path, folder_for, joined, state_of
from tiler.io.partial_files import appearing


def write_text(store_url: str, work: WriteText) -> dict[str, Any]:
    """Write ``<out>/<name>``; a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``path``, ``bytes``, ``digest`` and ``state``, as those of `tiler.export.write_cog`.

    Raises
    ------
    ProcessingError
        The disk is full or the file cannot be written.
    """
    with folder_for(work.out) as folder:
        target = folder / work.name
        try:
            with appearing(target) as partial, open(partial, "wb") as stream:
                stream.write(work.text.encode())
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:
            raise refused_write(str(target), error, folder) from error
        record = {"path": work.name, "bytes": target.stat().st_size, "digest": digest_of_file(target)}
    return {**record, "state": state_of(cloud_path(joined(work.out, work.name))).to_json()}
