import subprocess
import sys

import pytest

from tests.waiting import PATIENCE_SECONDS


@pytest.mark.processes
def test_a_process_that_ends_while_dask_is_imported_prints_nothing() -> None:
    program = "import tiler.schedule as schedule; schedule.import_dask()"
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=PATIENCE_SECONDS,
    )
    assert done.returncode == 0
    assert done.stderr == ""
