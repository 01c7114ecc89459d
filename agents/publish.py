"""Publish an export (python -m agents.export) as a model of the Hugging Face Hub.

The repository gets the files as they lie in FOLDER: model card, policy.onnx with its description and runner, and the
model of Stable-Baselines3 under the name that huggingface_sb3.load_from_hub expects, ppo-SoilWheel-v0.zip. With
--dry-run nothing is sent: what would be is checked and listed. Without it huggingface_hub is needed, and a login
(hf auth login). The repository is made where there is none, private unless --public is given.

Examples:
  python -m agents.publish policy --repo you/ppo-SoilWheel-v0 --dry-run
  python -m agents.publish policy --repo you/ppo-SoilWheel-v0
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import yaml

from soil_env._io.commands import command, command_line, leave
from soil_env._io.document import Table
from soil_env._io.loading import ParameterError, read_yaml

from .cli import manual_parser
from .export import CARD, COURSE, DESCRIPTION, RUNNER, zip_name
from .exported import FORMAT, POLICY
from .progress import show

_NAME = f"{__package__}.publish"
_REPO = re.compile(r"[\w][\w.-]{0,95}/[\w][\w.-]{0,95}")
_MOST = 50_000_000  # [bytes] of a file that is no large file of git


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = manual_parser(command(_NAME), __doc__)
    p.add_argument("folder", metavar="FOLDER", type=Path, help="folder of an export")
    p.add_argument("--repo", metavar="USER/NAME", required=True, help="repository on the Hub")
    p.add_argument("--public", action="store_true", help="make the repository public")
    p.add_argument("--dry-run", action="store_true", help="check and list, send nothing")
    return p


@command_line(_NAME)
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options = parser().parse_args(arguments)
    if not _REPO.fullmatch(options.repo):
        raise ParameterError(f"--repo {options.repo}: expected USER/NAME of letters, digits, '-', '_' and '.'")
    files = checked(options.folder)
    rows = [[f.name, f"{f.stat().st_size / 1024:.1f}"] for f in files]
    show(Table(["file", "KiB"], rows, f"{options.folder} -> https://huggingface.co/{options.repo}"))
    if options.dry_run:
        show("Nothing was sent (--dry-run).")
        return 0
    show(f"Published: {_send(options.folder, files, options.repo, options.public)}")
    return 0


def checked(folder: Path) -> list[Path]:
    """The files to publish; ParameterError where one is missing, or the card is not one that the Hub reads."""
    description = read_yaml(folder / DESCRIPTION)
    if description.get("format") != FORMAT:
        raise ParameterError(f"{folder / DESCRIPTION}: expected a description {FORMAT!r}, written by agents.export")
    names = (CARD, POLICY, DESCRIPTION, RUNNER, COURSE, zip_name(description), "config.json", "results.json")
    files = [folder / name for name in names]
    for file in files:
        if not file.is_file():
            raise ParameterError(f"{file}: is missing; expected the folder of an export")
        if file.stat().st_size > _MOST:
            raise ParameterError(f"{file}: {file.stat().st_size} bytes: expected at most {_MOST}")
    _check_card(folder / CARD)
    return files


def _check_card(path: Path) -> None:
    head, _, rest = path.read_text(encoding="utf-8").removeprefix("---\n").partition("\n---\n")
    try:
        header = yaml.safe_load(head)
        metric = header["model-index"][0]["results"][0]["metrics"][0]
        right = header["library_name"] == "stable-baselines3" and metric["type"] == "mean_reward" and rest.strip()
    except (yaml.YAMLError, KeyError, IndexError, TypeError):
        right = False
    if not right:
        raise ParameterError(f"{path}: expected a model card with library_name and model-index at its head")


def _send(folder: Path, files: list[Path], repo: str, public: bool) -> str:
    """Upload; the address of the repository."""
    try:
        import huggingface_hub
    except ImportError:
        raise ParameterError("needs huggingface_hub: pip install 'soil_env[publish]'") from None
    try:
        address = huggingface_hub.create_repo(repo, private=not public, exist_ok=True)
        huggingface_hub.upload_folder(
            repo_id=repo, folder_path=str(folder), allow_patterns=[f.name for f in files],
            commit_message="Export of soil_env",
        )  # fmt: skip
    except Exception as error:  # of the network, of the Hub, of the login
        raise ParameterError(f"{repo}: not published ({(str(error).splitlines() or [''])[0][:200]})") from None
    return str(address)


if __name__ == "__main__":
    leave(main())
