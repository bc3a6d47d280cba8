#!/usr/bin/env python3
"""Packs the Foxglove extension: `.ci/foxe.py MODULE FILE.foxe`, in the root of the repository.

An extension is a zip file with its manifest, README.md, CHANGELOG.md and one script, which contains the module. The same
module gives the same bytes.
"""

import base64
import json
import re
import sys
import zipfile
from pathlib import Path

FOLDER = Path("src/foxglove/extension")


def main() -> None:
    module, out = Path(sys.argv[1]), Path(sys.argv[2])
    manifest = json.loads((FOLDER / "package.json").read_text(encoding="utf-8"))
    workspace = Path("Cargo.toml").read_text(encoding="utf-8").partition("[workspace.package]\n")[2]
    manifest["version"] = re.match(r'version = "(.*)"', workspace)[1]
    script = (FOLDER / "extension.js").read_text(encoding="utf-8")
    packed = base64.b64encode(module.read_bytes()).decode("ascii")
    files = {
        "package.json": json.dumps(manifest, indent=2) + "\n",
        "README.md": (FOLDER / "README.md").read_text(encoding="utf-8"),
        "CHANGELOG.md": Path("CHANGELOG.md").read_text(encoding="utf-8"),
        "dist/extension.js": script.replace("POSEAUDIT_WASM", packed),
    }
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name)  # with the earliest date, not today's
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content, compresslevel=9)
    print(f"the Foxglove extension is {out}: {out.stat().st_size // 1000} kB, its module {module.stat().st_size // 1000} kB")


main()
