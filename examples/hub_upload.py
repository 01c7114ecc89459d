"""Upload an exported agent to the Hugging Face Hub, with a model card.

    pip install "soil_env[export]" "huggingface_hub>=0.34"     and once: hf auth login
    soil-env export runs/NAME --out policy
    python examples/hub_upload.py policy --repo you/soil-wheel --dry-run     lists the files, sends nothing
    python examples/hub_upload.py policy --repo you/soil-wheel

The repository gets policy.onnx, policy.yaml, run_policy.py, course.npz and README.md, the card. A new repository is
private unless --public is given. Whoever loads the agent needs numpy and onnxruntime only.
"""

import argparse
import sys
from pathlib import Path

import huggingface_hub
import yaml

FILES = ("policy.onnx", "policy.yaml", "run_policy.py", "course.npz")


def card(description: dict) -> str:
    """README.md with the header that the Hub reads."""
    header = {"license": "mit", "library_name": "onnx", "tags": ["reinforcement-learning", "SoilWheel-v0", "onnx"]}
    inputs = "\n".join(f"| {e['name']} | {e['unit']} | {e['low']:g} | {e['high']:g} |" for e in description["inputs"])
    output, scenario = description["output"], description["scenario"]["name"]
    scale = f"{output['scale']['value']:g} {output['scale']['unit']}"
    return f"""---
{yaml.safe_dump(header)}---
# {description["name"]}

Driver of a wheel on soil, trained on scenario `{scenario}` of soil_env {description["versions"]["soil_env"]}.
`python run_policy.py` runs it. Output: {output["meaning"]}, 1 is {scale}, every {description["rate"]["period"]:g} s.
Simulated, not tested on a vehicle.

| input | unit | low | high |
|---|---|---|---|
{inputs}
"""


def main() -> int:
    """Check the folder, write the card, upload."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("folder", type=Path, help="folder of an export")
    p.add_argument("--repo", required=True, metavar="USER/NAME")
    p.add_argument("--public", action="store_true")
    p.add_argument("--dry-run", action="store_true", help="send nothing")
    options = p.parse_args()
    missing = [name for name in FILES if not (options.folder / name).is_file()]
    if missing:
        p.error(f"{options.folder}: no {', '.join(missing)}: expected the folder of an export")
    description = yaml.safe_load((options.folder / "policy.yaml").read_text(encoding="utf-8"))
    (options.folder / "README.md").write_text(card(description), encoding="utf-8")
    for name in (*FILES, "README.md"):
        print(f"{name:14s} {(options.folder / name).stat().st_size / 1024:8.1f} KiB")
    if options.dry_run:
        return 0
    huggingface_hub.create_repo(options.repo, private=not options.public, exist_ok=True)
    huggingface_hub.upload_folder(
        repo_id=options.repo, folder_path=str(options.folder), allow_patterns=[*FILES, "README.md"]
    )
    print(f"uploaded: https://huggingface.co/{options.repo}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
