"""A fit by an optimiser of PyTorch, with a prior of one's own on the albedo.

    python examples/pytorch.py SCENE        # a scene folder; without one, a small synthetic room

`Objective.torch()` gives the loss as a function that PyTorch differentiates, so that it can be part
of any graph. Needs PyTorch: pip install 'pbrfit[torch]'.
"""

from __future__ import annotations

import argparse

import torch

import pbrfit
from pbrfit.synthetic import make_scene


def fit(scene: pbrfit.Scene, steps: int, prior: float) -> tuple[pbrfit.Objective, torch.Tensor]:
    """Adam over all unknowns of a scene; returns its objective and the x that was found."""
    objective = pbrfit.Objective(scene)
    data_loss = objective.torch()
    low, high = torch.from_numpy(objective.bounds).T
    x = torch.from_numpy(objective.start()).requires_grad_()
    optimiser = torch.optim.Adam([x], lr=0.02)
    for step in range(steps):
        optimiser.zero_grad()
        # Albedo far from the middle of its range is unlikely: a prior, as an example.
        loss = data_loss(x) + prior * (x[objective.albedo] - 0.5).square().mean()
        loss.backward()
        optimiser.step()
        with torch.no_grad():
            x.clamp_(low, high)  # the objective refuses materials outside [0, 1]
        if step % 50 == 0 or step == steps - 1:
            print(f"step {step}: loss {loss.item():.3g}")
    return objective, x.detach()


def main() -> None:
    """Fit the scene of the command line, and say what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", help="default: a synthetic room")
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--prior", type=float, default=1e-5, help="weight of the prior")
    options = parser.parse_args()
    scene = (
        pbrfit.Scene.load(options.scene)
        if options.scene
        else make_scene("room", size=48, lights=8, noise=0.004, seed=3)
    )
    objective, x = fit(scene, options.steps, options.prior)
    materials, lighting = objective.unpack(x.numpy())
    albedo = float(x[objective.albedo].mean())
    print(f"{materials!r}, mean albedo {albedo:.3g}, lights {lighting.shape}")


if __name__ == "__main__":
    main()
