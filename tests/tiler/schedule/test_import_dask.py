import subprocess
import sys


def test_a_process_that_ends_while_dask_is_imported_prints_nothing() -> None:
    program = "import tiler.schedule as schedule; schedule.import_dask()"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0
    assert done.stderr == ""
