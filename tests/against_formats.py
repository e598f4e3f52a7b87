#!/usr/bin/env python3
"""Bytes, time and error of one ray-tree frame in our formats and in those that exist, in one table.

    python3 -m venv env && env/bin/pip install numpy==2.2.6 opencv-python-headless==4.12.0.88 OpenEXR==3.4.4 zstandard==0.25.0
    cargo build --release
    target/release/warplight-client bench --only codec --scene gallery --planes planes --json > bench.json
    env/bin/python tests/against_formats.py planes bench.json

Ours: what `bench` measured over its frames, on all cores, and the planes of the last frame, which it wrote before and after.
Theirs: the same planes of that last frame, by the C and C++ libraries behind the Python packages, best of three.

- thesis: the uncompressed frame of the thesis (colour linear 8 bits, depth 16 bits, validity, index), by `bench`.
- raw + zstd: codes as we quantise them (colour root 8 bits, inverse depth and octahedral normals 16 bits), plane by plane,
  one thread.
- PNG: the same codes, colour as RGB, depth as grey of 16 bits, normals as two greys of 16 bits; OpenCV, level 1, one thread.
- EXR: one file of all channels: colour and normals half floats, distance float, masks as half floats; OpenEXR's own threads.
  What is undefined is 0, as in all the others. DWAA loses colour and normals at its default level of 45.

Errors are against the planes before coding: PSNR of colour in codes of root 8 bits over all pixels that any node knows; of
depth the largest displayed error in pixels of the root, and of all nodes, for a head that moves by 20 cm.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

MOTION_M = 0.2
FOV_RAD = 1.4


def read(folder: Path) -> dict[str, np.ndarray]:
    """The planes of a frame by name, square."""
    planes = {}
    for file in sorted(folder.glob("*.f32")):
        values = np.fromfile(file, np.float32)
        side = int(round(values.size**0.5))
        planes[file.stem] = values.reshape(side, side)
    if not planes:
        sys.exit(f"{folder}: expected planes written by 'bench --only codec --planes'")
    return planes


def nodes_of(planes: dict) -> list[str]:
    return sorted({name.rsplit(".", 1)[0] for name in planes if name.endswith(".distance")}, key=lambda n: (len(n), n))


def defined(planes: dict, node: str) -> np.ndarray:
    return planes[f"{node}.distance"] > 0 if node != "root" else np.ones_like(planes["root.distance"], bool)


def root_codes(linear: np.ndarray) -> np.ndarray:
    return np.sqrt(np.clip(linear, 0, 1)) * 255


def ray_lengths(side: int) -> np.ndarray:
    focal = side / 2 / np.tan(FOV_RAD / 2)
    slope = (np.arange(side) + 0.5 - side / 2) / focal
    return np.sqrt(slope[None, :] ** 2 + slope[:, None] ** 2 + 1)


def path(planes: dict, node: str) -> np.ndarray:
    """Distance from the eye along the chain of a node: what its depth is displayed by."""
    names = {"refract.refract": ["root", "refract", "refract.refract"], "root": ["root"]}.get(node, ["root", node])
    return sum(np.where(planes[f"{name}.distance"] > 0, planes[f"{name}.distance"], 0) for name in names)


def errors(before: dict, after: dict) -> tuple[float, float, float]:
    """PSNR of colour, and the largest error of depth in pixels, of the root and of all."""
    squares, count, worst = 0.0, 0, {}
    side = before["root.distance"].shape[0]
    focal, lengths = side / 2 / np.tan(FOV_RAD / 2), ray_lengths(side)
    for node in nodes_of(before):
        mask = defined(before, node)
        for channel in "RGB":
            name = f"{node}.radiance.{channel}"
            difference = (root_codes(before[name]) - root_codes(after[name]))[mask]
            squares, count = squares + float((difference.astype(np.float64) ** 2).sum()), count + difference.size
        with np.errstate(divide="ignore"):
            inverse = [lengths / path(planes, node).astype(np.float64) for planes in (before, after)]
        off = np.abs(inverse[0] - inverse[1])[mask] * focal * MOTION_M
        worst[node] = float(off.max()) if off.size else 0.0
    psnr = 10 * np.log10(255**2 * count / squares) if squares else np.inf
    return psnr, worst["root"], max(worst.values())


def octahedral(planes: dict, node: str) -> list[np.ndarray]:
    x, y, z = (planes[f"{node}.normal.{axis}"].astype(np.float64) for axis in "XYZ")
    total = np.maximum(np.abs(x) + np.abs(y) + np.abs(z), 1e-20)
    x, y = x / total, y / total
    folded = [(1 - np.abs(y)) * np.copysign(1, x), (1 - np.abs(x)) * np.copysign(1, y)]
    codes = [np.where(z >= 0, straight, under) for straight, under in zip((x, y), folded)]
    return [np.round((code * 0.5 + 0.5) * 4094).astype(np.uint16) for code in codes]


def codes(planes: dict) -> dict[str, np.ndarray]:
    """The planes as integers, undefined pixels 0."""
    coded = {}
    lengths = ray_lengths(planes["root.distance"].shape[0])
    for node in nodes_of(planes):
        mask = defined(planes, node)
        color = np.stack([np.round(root_codes(planes[f"{node}.radiance.{c}"])) for c in "RGB"], -1).astype(np.uint8)
        coded[f"{node}.color"] = np.where(mask[..., None], color, 0)
        with np.errstate(divide="ignore"):
            inverse = np.where(mask, lengths / path(planes, node).astype(np.float64), 0)
        coded[f"{node}.depth"] = np.round(inverse / max(inverse.max(), 1e-30) * 65535).astype(np.uint16)
        if f"{node}.interface" in planes:
            index = planes[f"{node}.interface"].astype(np.uint8)
            coded[f"{node}.interface"] = index
            for axis, code in zip("uv", octahedral(planes, node)):
                coded[f"{node}.normal.{axis}"] = np.where(index > 0, code, 0).astype(np.uint16)
        if node != "root":
            coded[f"{node}.validity"] = np.packbits(mask, axis=1)
    return coded


def decoded_codes(planes: dict, coded: dict) -> dict:
    """What is left of colour and depth in [`codes`]."""
    after = dict(planes)
    lengths = ray_lengths(planes["root.distance"].shape[0])
    sums = {}
    for node in nodes_of(planes):
        mask = defined(planes, node)
        for at, channel in enumerate("RGB"):
            after[f"{node}.radiance.{channel}"] = (coded[f"{node}.color"][..., at] / 255.0) ** 2
        with np.errstate(divide="ignore"):
            largest = np.where(mask, lengths / path(planes, node).astype(np.float64), 0).max()
            sums[node] = lengths / (coded[f"{node}.depth"] / 65535 * largest)
        parent = {"root": None, "refract.refract": "refract"}.get(node, "root")
        before = sums[parent] if parent else 0
        after[f"{node}.distance"] = np.where(mask, np.maximum(sums[node] - before, 1e-6), 0)
    return after


def best(work, runs: int = 3):
    """The least time of several runs in milliseconds, and what the last returned."""
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        result = work()
        times.append((time.perf_counter() - start) * 1e3)
    return min(times), result


def raw_zstd(coded: dict, level: int):
    import zstandard

    packer, opener = zstandard.ZstdCompressor(level=level), zstandard.ZstdDecompressor()
    encode_ms, packed = best(lambda: [packer.compress(plane.tobytes()) for plane in coded.values()])
    decode_ms, _ = best(lambda: [opener.decompress(plane) for plane in packed])
    return sum(map(len, packed)), encode_ms, decode_ms


def png(coded: dict):
    import cv2

    cv2.setNumThreads(1)
    level = [cv2.IMWRITE_PNG_COMPRESSION, 1]
    encode_ms, packed = best(lambda: [cv2.imencode(".png", plane, level)[1] for plane in coded.values()])
    decode_ms, _ = best(lambda: [cv2.imdecode(plane, cv2.IMREAD_UNCHANGED) for plane in packed])
    return sum(plane.size for plane in packed), encode_ms, decode_ms


def exr(planes: dict, compression: str):
    import OpenEXR

    def stored(name: str) -> np.ndarray:
        node = next(node for node in reversed(nodes_of(planes)) if name.startswith(f"{node}."))
        known = planes[f"{node}.interface"] > 0 if ".normal." in name else defined(planes, node)
        values = np.where(known, planes[name], 0)
        return values if name.endswith("distance") else np.minimum(values, 65504).astype(np.float16)

    channels = {name: stored(name) for name in planes if "shape" not in name}
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": OpenEXR.scanlineimage}
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
        file = str(Path(folder) / "frame.exr")
        encode_ms, _ = best(lambda: OpenEXR.File(header, channels).write(file))
        decode_ms, read_back = best(lambda: OpenEXR.File(file, separate_channels=True).channels())
        size = Path(file).stat().st_size
        after = dict(planes)
        after.update({name: read_back[name].pixels.astype(np.float32) for name in channels})
    return size, encode_ms, decode_ms, after


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("planes", type=Path, help="folder that bench wrote")
    parser.add_argument("bench", type=Path, help="what bench printed with --json")
    arguments = parser.parse_args()
    source = read(arguments.planes / "source")
    pixels = source["root.distance"].size
    rows = []

    timed = {}
    for row in json.loads(arguments.bench.read_text())["rows"]:
        if row["stage"] in ("encode", "decode"):
            timed.setdefault(row["case"], {})[row["stage"]] = row
    for case, stages in timed.items():
        name = (case.split(" ", 2) + ["default"])[2]
        after = read(arguments.planes / name)
        bits = stages["encode"]["bits_per_pixel"]
        rows.append((f"ours, {name}", bits, stages["encode"]["median_ms"], stages["decode"]["median_ms"], *errors(source, after)))

    coded = codes(source)
    coded_errors = errors(source, decoded_codes(source, coded))
    for level in (1, 3):
        size, encode_ms, decode_ms = raw_zstd(coded, level)
        rows.append((f"raw + zstd-{level}", size * 8 / pixels, encode_ms, decode_ms, *coded_errors))
    size, encode_ms, decode_ms = png(coded)
    rows.append(("PNG", size * 8 / pixels, encode_ms, decode_ms, *coded_errors))
    for compression in ("ZIP", "PIZ", "DWAA"):
        size, encode_ms, decode_ms, after = exr(source, compression)
        rows.append((f"EXR, {compression}", size * 8 / pixels, encode_ms, decode_ms, *errors(source, after)))

    print("| format | bits/pixel | encode ms | decode ms | colour PSNR dB | root depth, px | any depth, px |")
    print("|---|---|---|---|---|---|---|")
    for name, bits, encode_ms, decode_ms, psnr, root_px, any_px in rows:
        print(f"| {name} | {bits:.3f} | {encode_ms:.1f} | {decode_ms:.1f} | {psnr:.1f} | {root_px:.3f} | {any_px:.3f} |")


if __name__ == "__main__":
    main()
