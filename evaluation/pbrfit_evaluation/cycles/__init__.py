"""Pictures of synthetic worlds by Cycles, Blender's path tracer, for ground truth beyond our model.

Cycles runs in a Python of its own that has bpy (`make cycles-env`); nothing here imports it. See
docs/cycles.md.
"""

from __future__ import annotations

from pbrfit_evaluation.cycles.job import Transport
from pbrfit_evaluation.cycles.process import CyclesError, CyclesNotFoundError, why_not
from pbrfit_evaluation.cycles.scene import SAMPLES, Light, render_scene, true_lamps

__all__ = [
    "SAMPLES",
    "CyclesError",
    "CyclesNotFoundError",
    "Light",
    "Transport",
    "render_scene",
    "true_lamps",
    "why_not",
]
