"""The script of the whole check, with a `make` that does nothing."""

import os
import subprocess
import sys
import time

import pytest

from tests.conftest import ROOT

#: `make train` writes its process and lasts until it is ended; `make test` fails.
MAKE = """#!/bin/sh
case "$1" in
    train) echo $$ > "$HERE/train"; exec sleep 60 ;;
    test) while [ ! -s "$HERE/train" ]; do sleep 0.1; done; exit 3 ;;
esac
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_failed_check_leaves_no_training_behind(tmp_path):
    make = tmp_path / "make"
    make.write_text(MAKE)
    make.chmod(0o755)
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "HERE": str(tmp_path)}
    done = subprocess.run([ROOT / ".ci" / "run"], env=environment, timeout=50)
    assert done.returncode == 3
    process = int((tmp_path / "train").read_text())
    for _ in range(100):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail(f"process {process} is still there")
