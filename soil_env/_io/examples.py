"""Copy the examples, short scripts and the data that they use, into a folder of your own: `soil-env-examples`.

In a clone they are in examples/.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from soil_env._io.commands import command_line, command_parser, leave
from soil_env._io.files import check_outputs, is_unused
from soil_env._io.loading import ParameterError, shipped_dir


@command_line("soil_env._io.examples")
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    p = command_parser("soil-env-examples", __doc__)
    p.add_argument("folder", nargs="?", type=Path, default=Path("examples"), help="made for them (default: examples)")
    p.add_argument("--list", action="store_true", help="say what there is, copy nothing")
    options = p.parse_args(arguments)
    source = shipped_dir("examples")
    files = sorted(f.relative_to(source) for f in source.rglob("*") if f.is_file() and "__pycache__" not in f.parts)
    if options.list:
        print(*files, sep="\n")
        return 0
    if options.folder.resolve() == source.resolve():
        raise ParameterError(f"{options.folder}: has the examples already, as every clone: nothing to copy")
    if not is_unused(options.folder):
        raise ParameterError(f"{options.folder}: is not empty: expected a folder to be made")
    check_outputs(options.folder, map(str, files))
    for file in files:
        (options.folder / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / file, options.folder / file)
    print(f"Written to {options.folder}: {len(files)} files; begin with {options.folder / 'README.md'}")
    return 0


if __name__ == "__main__":
    leave(main())
