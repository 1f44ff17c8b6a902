"""Read a document by MaterialX itself. Runs where the MaterialX wheel is.

    python materialx_reader.py FILE

Prints what it found as JSON: whether it is valid, the definition of each node, and of the GLSL made
of each material whether it decodes sRGB and which files it reads.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import MaterialX as mx  # noqa: N813
from MaterialX import PyMaterialXGenGlsl, PyMaterialXGenShader


def main(path: Path) -> None:
    """Read, look up, generate, print."""
    library = mx.createDocument()
    search = mx.getDefaultDataSearchPath()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), search, library)
    document = mx.createDocument()
    document.setDataLibrary(library)
    mx.readFromXmlFile(document, str(path))
    valid, message = document.validate()
    graph = document.getNodeGraph("maps")
    definitions = {
        f"{prefix}{node.getName()}": node.getNodeDef().getName() if node.getNodeDef() else None
        for prefix, nodes in (("", document.getNodes()), ("maps/", graph.getNodes()))
        for node in nodes
    }
    scale = graph.getNode("normal").getInput("scale")
    found = {
        "valid": valid,
        "message": message,
        "definitions": definitions,
        "normal_scale": list(scale.getValue()) if scale else None,
        "shaders": shaders(document, search, path.parent),
    }
    print(json.dumps(found))


def shaders(document: Any, search: Any, folder: Path) -> dict[str, Any]:
    """GLSL of each material, in a few facts."""
    made = PyMaterialXGenGlsl.GlslShaderGenerator.create()
    context = PyMaterialXGenShader.GenContext(made)
    context.registerSourceCodeSearchPath(search)
    colors = PyMaterialXGenShader.DefaultColorManagementSystem.create(made.getTarget())
    colors.loadLibrary(document)
    made.setColorManagementSystem(colors)
    found = {}
    for material in document.getMaterialNodes():
        shader = made.generate(material.getName(), material, context)
        stage = shader.getStage("pixel")
        uniforms = stage.getUniformBlock("PublicUniforms")
        files = [
            str(folder / port.getValue().getValueString())
            for port in uniforms
            if port.getType().getName() == "filename" and port.getValue()
        ]
        decodes = "srgb_texture" in shader.getSourceCode("pixel").lower()
        found[material.getName()] = {"decodes_srgb": decodes, "files": files}
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]))
