"""Changes of the soil_env.json of a saved agent."""

import json
import zipfile
from pathlib import Path

META = "soil_env.json"


def rewrite(path: Path, content: bytes | None) -> None:
    """Replace soil_env.json in the zip of an agent by `content`, None = leave it out; the rest stays as it is."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    assert META in members
    members[META] = content
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            if data is not None:
                archive.writestr(name, data)


def edit(path: Path, **changes) -> None:
    """Change keys of soil_env.json in the zip of an agent; None takes a key out."""
    with zipfile.ZipFile(path) as archive:
        meta = json.loads(archive.read(META))
    meta.update(changes)
    rewrite(path, json.dumps({key: value for key, value in meta.items() if value is not None}).encode())
