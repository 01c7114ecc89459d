"""`soil-env examples`."""

from pathlib import Path

import click

from soil_env._io.files import check_outputs, is_unused, replace_files
from soil_env._io.loading import ParameterError, shipped_dir

from .running import PATH


@click.command("examples")
@click.argument("folder", type=PATH, metavar="FOLDER", default="examples")
def command(folder: Path) -> None:
    """Copy the example scripts and their data into FOLDER (default: examples)."""
    source = shipped_dir("examples")
    files = sorted(
        f.relative_to(source)
        for f in source.rglob("*")
        if f.is_file() and "__pycache__" not in f.parts
    )
    if folder.resolve() == source.resolve():
        raise ParameterError(f"{folder}: has the examples already, as every clone: nothing to copy")
    if not is_unused(folder):
        raise ParameterError(f"{folder}: is not empty: expected a new folder")
    check_outputs(folder, map(str, files))
    replace_files(folder, {str(file): (source / file).read_bytes() for file in files})
    print(f"written: {len(files)} files in {folder}; begin with {folder / 'README.md'}")
