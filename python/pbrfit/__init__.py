"""pbrfit: physically based materials and lighting from several pictures of one view."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    """Of the installed distribution."""

    from pbrfit import kernel as kernel
    from pbrfit._core import InputError
    from pbrfit.export import Exported, export_result
    from pbrfit.fit.decompose import Progress, decompose
    from pbrfit.fit.objective import Objective
    from pbrfit.model.environment import Environment
    from pbrfit.model.materials import Materials
    from pbrfit.report import write_report
    from pbrfit.result.data import Status
    from pbrfit.result.options import FitOptions, Priors
    from pbrfit.result.relighting import DirectionalLight, PointLight, relight
    from pbrfit.result.result import Result
    from pbrfit.scene.arrays import Truth
    from pbrfit.scene.scene import Scene

__all__ = [
    "DirectionalLight",
    "Environment",
    "Exported",
    "FitOptions",
    "InputError",
    "Materials",
    "Objective",
    "PointLight",
    "Priors",
    "Progress",
    "Result",
    "Scene",
    "Status",
    "Truth",
    "decompose",
    "export_result",
    "relight",
    "write_report",
]

_MODULES = {
    "_core": ("InputError",),
    "export": ("Exported", "export_result"),
    "fit.decompose": ("Progress", "decompose"),
    "fit.objective": ("Objective",),
    "model.environment": ("Environment",),
    "model.materials": ("Materials",),
    "report": ("write_report",),
    "result.data": ("Status",),
    "result.options": ("FitOptions", "Priors"),
    "result.relighting": ("DirectionalLight", "PointLight", "relight"),
    "result.result": ("Result",),
    "scene.arrays": ("Truth",),
    "scene.scene": ("Scene",),
}
"""Where the public names are; each is imported when first asked for: the fit is slow to import."""


if not TYPE_CHECKING:  # or type checkers took any name for one

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            from importlib.metadata import version  # takes longer to import than all of this

            globals()[name] = version("pbrfit")
            return globals()[name]
        if name == "kernel":
            return import_module("pbrfit.kernel")
        for module, names in _MODULES.items():
            if name in names:
                value = globals()[name] = getattr(import_module(f"pbrfit.{module}"), name)
                return value
        raise AttributeError(f"module 'pbrfit' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__", "kernel"]
