#!/usr/bin/env python3
"""Layers of volume as JPEG 2000 pictures, as in the thesis's figure 3.26: what another codec makes of our planes.

    python3 -m venv env && env/bin/pip install numpy==2.2.6 imagecodecs==2025.11.11
    target/release/warplight-client sweep volume-compression --scene S --size 1024x1024 --planes planes --quick
    env/bin/python tests/against_jpeg2000.py planes
    target/release/warplight-client sweep volume-compression --scene S --size 1024x1024 --planes planes

The first sweep writes the planes of the default frame (four layers), this makes of them what JPEG 2000 leaves at several
rates, and the second sweep measures those folders by what is displayed of them, beside our own codings.

As the thesis says, a layer is a colour C = S (1 - exp(-tau)), an opacity and depths, each a picture of its own, and S is made
again from C and the opacity. To be fair to JPEG 2000 its planes are laid out as suits it, not as the thesis had them: C by
its root as 8-bit RGB with the codec's colour transform; opacity 8 bits by its root; front and back as 12-bit steps of
inverse depth, as ours; pixels without a segment hold the mean of those with one, and which they are is taken from us for
free (nothing is counted for it). Every plane of every layer has the same PSNR asked of it (`--db`); depths, of which a
wrong code moves matter, have 10 dB more.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

SOURCE_NAMES = ("front", "back", "optical_depth", "source.R", "source.G", "source.B")


def read(folder: Path) -> list[dict[str, np.ndarray]]:
    layers = []
    while (folder / f"{len(layers)}.front.f32").is_file():
        layer = {name: np.fromfile(folder / f"{len(layers)}.{name}.f32", np.float32) for name in SOURCE_NAMES}
        side = int(round(layer["front"].size ** 0.5))
        layers.append({name: plane.reshape(side, side) for name, plane in layer.items()})
    if not layers:
        sys.exit(f"{folder}: expected planes written by 'sweep volume-compression --planes'")
    return layers


def filled(plane: np.ndarray, mask: np.ndarray) -> np.ndarray:
    return np.where(mask if plane.ndim == 2 else mask[..., None], plane, plane[mask].mean(axis=0) if mask.any() else 0)


def through(plane: np.ndarray, decibel: float, bits: int) -> tuple[np.ndarray, int, float]:
    """A plane of codes after JPEG 2000, its bytes, and the milliseconds of both ways."""
    import imagecodecs

    start = time.perf_counter()
    coded = imagecodecs.jpeg2k_encode(plane, level=decibel, codecformat="j2k", bitspersample=bits, reversible=False, mct=plane.ndim == 3)
    decoded = imagecodecs.jpeg2k_decode(coded)
    return decoded, len(coded), (time.perf_counter() - start) * 1e3


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("planes", type=Path, help="folder that the sweep wrote")
    parser.add_argument("--db", type=float, nargs="+", default=[24, 28, 32, 36, 40, 44, 48], help="PSNR asked of planes")
    arguments = parser.parse_args()
    layers = read(arguments.planes / "source")
    depths = np.concatenate([layer[name][layer["optical_depth"] > 0] for layer in layers for name in ("front", "back")])
    near, far = 1 / depths.max(), 1 / depths.min()
    brightest = max(float(layer[f"source.{c}"][layer["optical_depth"] > 0].max(initial=1e-6)) for layer in layers for c in "RGB")
    for decibel in arguments.db:
        folder = arguments.planes / f"jpeg2000-{decibel:g}dB"
        folder.mkdir(exist_ok=True)
        total, spent_ms = 0, 0.0
        for index, layer in enumerate(layers):
            tau = layer["optical_depth"]
            mask = tau > 0
            opacity = -np.expm1(-tau)
            color = np.stack([layer[f"source.{c}"] for c in "RGB"], -1) * opacity[..., None] / brightest
            codes = {
                "color": (np.round(255 * np.sqrt(np.clip(filled(color, mask), 0, 1))).astype(np.uint8), decibel, 8),
                "opacity": (np.round(255 * np.sqrt(filled(opacity, mask))).astype(np.uint8), decibel, 8),
            }
            for name in ("front", "back"):
                inverse = 1 / np.where(mask, layer[name], 1 / near)
                code = np.round(4095 * np.clip((inverse - near) / (far - near), 0, 1))
                codes[name] = (np.round(filled(code, mask)).astype(np.uint16), decibel + 10, 12)
            back = {}
            for name, (plane, asked, bits) in codes.items():
                back[name], size, elapsed_ms = through(plane, asked, bits)
                total, spent_ms = total + size, spent_ms + elapsed_ms
            opacity = (back["opacity"] / 255.0) ** 2
            # 255 would be infinitely dense: half a code below it is what it may have been.
            opacity = np.clip(opacity, 1e-4, (254.5 / 255) ** 2)
            color = (back["color"] / 255.0) ** 2 * brightest
            planes = {"optical_depth": np.where(mask, -np.log1p(-opacity), 0)}
            for channel, name in enumerate(("source.R", "source.G", "source.B")):
                planes[name] = np.where(mask, color[..., channel] / opacity, 0)
            for name in ("front", "back"):
                planes[name] = 1 / (near + back[name] / 4095.0 * (far - near))
            for name, plane in planes.items():
                plane.astype(np.float32).tofile(folder / f"{index}.{name}.f32")
        (folder / "bytes").write_text(f"{total}\n")
        pixels = layers[0]["front"].size
        print(f"{folder.name}: {total * 8 / pixels:.2f} bits/pixel, {spent_ms:.0f} ms for both ways")


if __name__ == "__main__":
    main()
