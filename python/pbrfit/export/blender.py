"""The Blender extension as the .zip that Blender installs.

The same bytes everywhere: members are in order, stored, and dated 1980.
"""

from __future__ import annotations

import io
from importlib.resources import files
from zipfile import ZipFile, ZipInfo

ZIP_FILE = "blender_extension.zip"
ZIP_HOLDS = (
    "extension for Blender 4.2 or later, File > Import > pbrfit result; to be installed once: "
    "Preferences, Get Extensions, Install from Disk"
)

_MEMBERS = {
    "blender_manifest.toml": "blender_extension/blender_manifest.toml",
    "__init__.py": "blender_extension/__init__.py",
    "view_mesh.py": "view_mesh.py",
}
"""Files of the extension, and where they are in this room."""


def extension() -> bytes:
    """Content of the .zip."""
    here = files("pbrfit.export")
    packed = io.BytesIO()
    with ZipFile(packed, "w") as archive:
        for name, path in _MEMBERS.items():
            archive.writestr(ZipInfo(name), here.joinpath(path).read_bytes())
    return packed.getvalue()
