"""Peers that see one picture, with tiny networks; an objective in PyTorch."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from acquire.tiny_maps import save_tiny_marigold_iid, save_tiny_rgbx
from pbrfit import Objective, Scene
from pbrfit.acquire.marigold import MarigoldIID
from pbrfit.cli import main
from pbrfit.io.color import decode_srgb
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.peers.rgbx import RgbToX


@pytest.fixture(scope="module")
def iid(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(save_tiny_marigold_iid(tmp_path_factory.mktemp("iid")))


@pytest.fixture(scope="module")
def rgbx(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(save_tiny_rgbx(tmp_path_factory.mktemp("rgbx")))


SHOWN = np.random.default_rng(0).integers(0, 256, (97, 131, 3), dtype=np.uint8)


def test_marigold_gives_maps_of_the_pictures_size(iid: str) -> None:
    peer = MarigoldIID(iid, device="cpu")
    found = peer.maps(SHOWN, seed=0, samples=3, steps=None)
    assert found.albedo.shape == (97, 131, 3)
    assert found.roughness.shape == found.metallic.shape == (97, 131)
    again = peer.maps(SHOWN, seed=0, samples=3, steps=None)
    np.testing.assert_array_equal(found.roughness, again.roughness)
    assert np.abs(found.roughness - found.metallic).mean() > 1e-3

    # Albedo is encoded, the scalars are not: what the pipeline itself gives says which is which.
    from PIL import Image

    raw = peer._network(
        Image.fromarray(SHOWN[:48, :64]),
        processing_resolution=0,
        ensemble_size=3,
        generator=torch.Generator().manual_seed(0),
    ).prediction.astype(np.float64)
    own = peer.maps(SHOWN[:48, :64], seed=0, samples=3, steps=None)  # of the network's own size
    np.testing.assert_allclose(own.albedo, decode_srgb(raw[0]), atol=1e-6)
    np.testing.assert_allclose(own.roughness, raw[1, ..., 0], atol=1e-6)
    np.testing.assert_allclose(own.metallic, raw[1, ..., 1], atol=1e-6)


def test_maps_become_estimates_of_a_scene(iid: str, tmp_path: Path) -> None:
    make_scene("room", size=48, lights=3).save(tmp_path / "scene")
    given = ["--model", iid, "--device", "cpu", "--ensemble", "3", "--steps", "1"]
    assert main(["maps", str(tmp_path / "scene"), *given]) == 0
    found = Scene.load(tmp_path / "scene").estimates
    assert found is not None
    assert found.albedo.shape == (48, 48, 3)
    assert 0 <= found.roughness.min() < found.roughness.max() <= 1


def test_rgbx_gives_maps_of_the_pictures_size(rgbx: str) -> None:
    peer = RgbToX(rgbx, device="cpu", longer_side=96)
    found = peer.maps(SHOWN, seed=0, steps=2)
    assert found.albedo.shape == (97, 131, 3)
    assert found.roughness.shape == found.metallic.shape == (97, 131)
    assert np.ptp(found.albedo) > 0
    assert 0 <= found.albedo.min() <= found.albedo.max() <= 1
    np.testing.assert_array_equal(found.albedo, peer.maps(SHOWN, seed=0, steps=2).albedo)
    assert np.abs(found.albedo - peer.maps(SHOWN, seed=1, steps=2).albedo).mean() > 1e-3
    assert np.abs(found.albedo - peer.maps(255 - SHOWN, seed=0, steps=2).albedo).mean() > 1e-4
    # Prompts differ, so do the answers to them.
    assert np.abs(found.roughness - found.metallic).max() > 1e-5


def test_rgbx_recovers_what_a_perfect_network_says(rgbx: str) -> None:
    # With a network that answers the v of a known map, DDIM has to end at that map exactly:
    # v = sqrt(a) e - sqrt(1 - a) x, from which x = sqrt(a) z - sqrt(1 - a) v at every step.
    import torch

    peer = RgbToX(rgbx, device="cpu", longer_side=96)
    parts = peer._parts
    known = torch.randn(1, 4, 12, 12, generator=torch.Generator().manual_seed(7))

    def answer(
        both: torch.Tensor, time: torch.Tensor, encoder_hidden_states: torch.Tensor
    ) -> object:
        assert encoder_hidden_states.shape == (1, 77, 32)
        noisy = both[:, :4]
        a = parts.scheduler.alphas_cumprod[time]
        # At zero SNR (a = 0) any e is right: v = -x.
        noise = (noisy - a.sqrt() * known) / (1 - a).sqrt()
        sample = a.sqrt() * noise - (1 - a).sqrt() * known
        return type("Answer", (), {"sample": sample})()

    object.__setattr__(parts, "unet", answer)
    found = peer._map(np.zeros((96, 96, 3), np.float32), "Roughness", 0, 5)
    with torch.no_grad():
        decoded = parts.autoencoder.decode(known / parts.autoencoder.config.scaling_factor).sample
    expected = (decoded[0].permute(1, 2, 0) / 2 + 0.5).clamp(0, 1).numpy()
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_the_suite_with_tiny_peers(iid: str, rgbx: str, tmp_path: Path) -> None:
    arguments = ["evaluate", "peers", "--out", str(tmp_path / "out"), "--quick", "--size", "32"]
    arguments += ["--marigold", iid, "--device", "cpu", "--jobs", "1", "--quiet"]
    assert main([*arguments, "--rgbx", str(tmp_path / "none")]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    rows = {row["solver"]: row for row in summary["rows"][:4]}
    assert [row["scenes"] for row in summary["rows"][:4]] == [2, 2, 2, 0]
    fit, peer = rows["pbrfit, all pictures"], rows["Marigold-IID, one picture"]
    assert fit["status"] == peer["status"] == "ok"
    assert fit["metrics"]["albedo"] < peer["metrics"]["albedo"]  # which has random weights
    assert "expected a folder with RGB-X" in rows["RGB-X, one picture"]["status"]

    # With the weights there, only what is missing is done.
    records = tmp_path / "out" / "records"
    before = {path.name: path.stat().st_mtime_ns for path in records.iterdir()}
    assert main([*arguments, "--rgbx", rgbx, "--resume"]) == 0
    after = {path.name: path.stat().st_mtime_ns for path in records.iterdir()}
    assert {name for name in after if after[name] != before.get(name)} == {
        "own_rgbx_furnished_6000.json",
        "own_rgbx_furnished_6001.json",
    }
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [row["status"] for row in summary["rows"][:4]] == ["ok"] * 4
    assert (tmp_path / "out" / "maps-own.png").exists()


def test_a_peer_that_breaks_is_a_failure(
    rgbx: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(RgbToX, "maps", broken)
    arguments = ["evaluate", "peers", "--out", str(tmp_path / "out"), "--quick", "--size", "24"]
    arguments += ["--scenes", "1", "--jobs", "1", "--device", "cpu", "--quiet"]
    assert main([*arguments, "--rgbx", rgbx, "--marigold", str(tmp_path / "none")]) == 1
    rows = json.loads((tmp_path / "out" / "summary.json").read_text())["rows"]
    assert [row["status"] for row in rows[:4]][::3] == ["ok", "1 of 1 scenes failed"]


EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "pytorch.py"


@pytest.mark.parametrize(("dtype", "digits"), [(torch.float32, 1e-6), (torch.float64, 1e-12)])
@pytest.mark.parametrize("mono_light", [False, True])
def test_its_gradient_takes_part_in_a_graph(dtype: object, digits: float, mono_light: bool) -> None:
    objective = Objective(make_scene("room", size=8, lights=2), mono_light=mono_light)
    x = torch.from_numpy(objective.start()).to(dtype).requires_grad_()
    value, gradient = objective.value_and_grad(x.detach().double().numpy())
    loss = objective.torch()(x)
    assert loss.dtype == dtype
    (3 * loss**2 + x.sum()).backward()
    np.testing.assert_allclose(loss.item(), value, rtol=digits)
    np.testing.assert_allclose(x.grad, 6 * value * gradient + 1, rtol=digits)


def test_the_example_lowers_the_loss() -> None:
    command = [sys.executable, str(EXAMPLE), "--steps=60"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    first, *_, last = (line.split("loss ")[1] for line in said.splitlines() if "loss" in line)
    assert float(last) < float(first) / 2
