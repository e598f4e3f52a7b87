#!/usr/bin/env python3
"""Speed and error of `warplight-server render` beside Mitsuba 3, on the same scenes, in one run.

    python3 -m venv env && env/bin/pip install mitsuba==3.9.1 numpy
    cargo build --release -p warplight-server
    env/bin/python tests/against_mitsuba.py [--server PATH] [--repeat N] [--out FOLDER] [--mesh FILE.ply]

Mitsuba's variant llvm_ad_rgb needs LLVM's shared library: on Debian `apt install libllvm19` and
`DRJIT_LIBLLVM_PATH=/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1`; without it only scalar_rgb is compared.

Scenes: Mitsuba's own Cornell box, and a mesh of 70,000 triangles under an environment with a sun (made here; or
--mesh). Both renderers read the same XML file. A time is that of rendering alone, without loading and compiling:
Mitsuba renders once before it is timed. Renderers take turns, so that what else the machine does falls on both.

Error is the relative mean squared error against a converged picture: of Mitsuba, with enough samples that its own
error is a hundredth; its variance is subtracted by using two halves (E[(x - a)(x - b)]). Samples per second tell
how fast a sample is; `efficiency`, 1 / (error x time), what one gets for one's time.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

SIDE, SPP, DEPTH = 512, 16, 6
REFERENCE_SPP = 1024


def bumpy_sphere(path: Path, rows: int = 150, columns: int = 234) -> None:
    """A closed mesh of 2 * rows * columns triangles, about as many as the Stanford bunny, as a binary PLY."""
    polar = np.linspace(0, np.pi, rows + 1)
    azimuth = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    p, a = np.meshgrid(polar, azimuth, indexing="ij")
    radius = 1 + 0.12 * np.sin(7 * p) * np.sin(5 * a) * np.sin(p) + 0.04 * np.sin(23 * a) * np.sin(19 * p) * np.sin(p)
    position = np.stack([radius * np.sin(p) * np.cos(a), radius * np.cos(p), radius * np.sin(p) * np.sin(a)], -1)
    index = np.arange((rows + 1) * columns).reshape(rows + 1, columns)
    right = np.roll(index, -1, axis=1)
    corners = [index[:-1], right[:-1], index[1:], right[:-1], right[1:], index[1:]]
    faces = np.stack(corners, -1).reshape(-1, 3).astype("<i4")
    with path.open("wb") as file:
        header = (
            "ply\nformat binary_little_endian 1.0\n"
            f"element vertex {position.size // 3}\nproperty float x\nproperty float y\nproperty float z\n"
            f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        )
        file.write(header.encode())
        file.write(position.reshape(-1, 3).astype("<f4").tobytes())
        rows_of_faces = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        rows_of_faces["count"] = 3
        rows_of_faces["corners"] = faces
        file.write(rows_of_faces.tobytes())


def sky(mi, path: Path) -> None:
    """A gradient with a small sun, 1024x512."""
    v, u = np.meshgrid(np.linspace(0, 1, 512), np.linspace(0, 1, 1024), indexing="ij")
    image = np.stack([0.3 + 0.5 * v, 0.4 + 0.4 * v, 0.9 - 0.3 * v], -1).astype(np.float32)
    sun = (u - 0.3) ** 2 * 4 + (v - 0.25) ** 2 < 0.0003
    image[sun] = [900, 800, 600]
    mi.Bitmap(image).write(str(path))


MESH_SCENE = """<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
    <sensor type="perspective">
        <float name="fov" value="45"/>
        <transform name="to_world"><lookat origin="{eye}" target="{target}" up="0, 1, 0"/></transform>
        <sampler type="independent"><integer name="sample_count" value="16"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="{side}"/><integer name="height" value="{side}"/><rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>
    <shape type="ply">
        <string name="filename" value="{mesh}"/>
        <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf></bsdf>
    </shape>
</scene>
"""

CORNELL = """<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
    <sensor type="perspective">
        <float name="fov" value="39.3077"/><string name="fov_axis" value="smaller"/>
        <transform name="to_world"><lookat origin="0, 0, 3.90" target="0, 0, 0" up="0, 1, 0"/></transform>
        <sampler type="independent"><integer name="sample_count" value="16"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="{side}"/><integer name="height" value="{side}"/><rfilter type="box"/>
        </film>
    </sensor>
    <bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.885809, 0.698859, 0.666422"/></bsdf>
    <bsdf type="diffuse" id="green"><rgb name="reflectance" value="0.105421, 0.37798, 0.076425"/></bsdf>
    <bsdf type="diffuse" id="red"><rgb name="reflectance" value="0.570068, 0.0430135, 0.0443706"/></bsdf>
    <shape type="rectangle">
        <transform name="to_world">
            <scale value="0.23, 0.19, 0.19"/><rotate x="1" angle="90"/><translate value="0, 0.99, 0.01"/>
        </transform>
        <ref id="white"/>
        <emitter type="area"><rgb name="radiance" value="18.387, 13.9873, 6.75357"/></emitter>
    </shape>
    <shape type="rectangle">
        <transform name="to_world"><rotate x="1" angle="-90"/><translate value="0, -1, 0"/></transform>
        <ref id="white"/>
    </shape>
    <shape type="rectangle">
        <transform name="to_world"><rotate x="1" angle="90"/><translate value="0, 1, 0"/></transform>
        <ref id="white"/>
    </shape>
    <shape type="rectangle">
        <transform name="to_world"><translate value="0, 0, -1"/></transform>
        <ref id="white"/>
    </shape>
    <shape type="rectangle">
        <transform name="to_world"><rotate y="1" angle="-90"/><translate value="1, 0, 0"/></transform>
        <ref id="green"/>
    </shape>
    <shape type="rectangle">
        <transform name="to_world"><rotate y="1" angle="90"/><translate value="-1, 0, 0"/></transform>
        <ref id="red"/>
    </shape>
    <shape type="cube">
        <transform name="to_world">
            <scale value="0.3"/><rotate y="1" angle="-17"/><translate value="0.335, -0.7, 0.38"/>
        </transform>
        <ref id="white"/>
    </shape>
    <shape type="cube">
        <transform name="to_world">
            <scale value="0.3, 0.61, 0.3"/><rotate y="1" angle="18.25"/><translate value="-0.33, -0.4, -0.28"/>
        </transform>
        <ref id="white"/>
    </shape>
</scene>
"""


def framing(mi, mesh: Path):
    """An eye and a target that have a mesh in sight."""
    box = mi.load_dict({"type": "scene", "mesh": {"type": "ply", "filename": str(mesh)}}).bbox()
    low, high = np.array(box.min).reshape(3), np.array(box.max).reshape(3)
    middle, extent = (low + high) / 2, float(np.linalg.norm(high - low))
    eye = middle + np.array([0.35, 0.35, 1.0]) * extent
    return ", ".join(map(str, eye)), ", ".join(map(str, middle))


class Mitsuba:
    def __init__(self, variant: str, scene: Path):
        import mitsuba as mi

        self.name, self.mi, self.variant = f"mitsuba {variant}", mi, variant
        mi.set_variant(variant)
        self.scene = mi.load_file(str(scene))
        self.render(0)

    def render(self, seed: int, spp: int = SPP):
        self.mi.set_variant(self.variant)
        start = time.perf_counter()
        image = np.array(self.mi.render(self.scene, spp=spp, seed=seed))
        return image[..., :3].astype(np.float64), time.perf_counter() - start


class Warplight:
    name = "warplight"

    def __init__(self, server: str, scene: Path):
        self.server, self.scene = server, scene
        self.out = scene.with_suffix(".exr")

    def render(self, seed: int, spp: int = SPP):
        import mitsuba as mi

        arguments = [self.server, "render", str(self.scene), "-o", str(self.out), "--size", f"{SIDE}x{SIDE}"]
        arguments += ["--spp", str(spp), "--max-depth", str(DEPTH), "--seed", str(seed), "--json"]
        figures = json.loads(subprocess.run(arguments, check=True, capture_output=True, text=True).stdout)
        image = np.array(mi.Bitmap(str(self.out)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32))
        return image.astype(np.float64), figures["seconds"]


def reference(renderer: Mitsuba):
    """Two independent halves."""
    passes = [[renderer.render(1000 + 2 * turn + half, 128)[0] for turn in range(REFERENCE_SPP // 256)] for half in (0, 1)]
    return [np.mean(half, axis=0) for half in passes]


def relative_mse(image, halves) -> float:
    mean = (halves[0] + halves[1]) / 2
    weight = 1 / (mean * mean + 1e-3)
    return float(np.mean((image - halves[0]) * (image - halves[1]) * weight))


def compare(title: str, scene: Path, server: str, variants, repeat: int):
    renderers = [Warplight(server, scene)] + [Mitsuba(variant, scene) for variant in variants]
    halves = reference(renderers[-1])
    figures = {renderer.name: [] for renderer in renderers}
    for turn in range(repeat):
        for renderer in renderers:
            image, seconds = renderer.render(turn + 1)
            figures[renderer.name].append((seconds, relative_mse(image, halves), image.mean(axis=(0, 1))))
    mean = ((halves[0] + halves[1]) / 2).mean(axis=(0, 1))
    print(f"\n{title}: {SIDE}x{SIDE}, {SPP} samples per pixel, depth {DEPTH}, median of {repeat}")
    print(f"| {'renderer':22} | Msamples/s | relative MSE | efficiency | mean off |")
    print(f"|{'-' * 24}|-----------:|-------------:|-----------:|---------:|")
    rows = {}
    for name, runs in figures.items():
        seconds = statistics.median(run[0] for run in runs)
        error = statistics.median(run[1] for run in runs)
        off = float(np.max(np.abs(np.mean([run[2] for run in runs], axis=0) / mean - 1)))
        rate = SIDE * SIDE * SPP / seconds * 1e-6
        rows[name] = {"msamples_per_s": rate, "relative_mse": error, "efficiency": 1 / (error * seconds), "off": off}
        print(f"| {name:22} | {rate:10.2f} | {error:12.5f} | {1 / (error * seconds):10.1f} | {off * 100:7.2f}% |")
    for name in list(rows)[1:]:
        ratio = [rows["warplight"][key] / rows[name][key] for key in ("msamples_per_s", "efficiency")]
        print(f"warplight over {name}: {ratio[0]:.2f}x the samples per second, {ratio[1]:.2f}x at equal error")
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    root = Path(__file__).resolve().parent.parent
    target = Path(os.environ.get("CARGO_TARGET_DIR", root / "target"))
    parser.add_argument("--server", default=str(target / "release/warplight-server"))
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--out", type=Path, help="where scenes, pictures and figures.json are left")
    parser.add_argument("--mesh", type=Path, help="a .ply instead of the mesh made here")
    arguments = parser.parse_args()
    import mitsuba as mi

    variants = ["scalar_rgb"]
    try:
        mi.set_variant("llvm_ad_rgb")
        mi.load_dict({"type": "sphere"})
        variants.append("llvm_ad_rgb")
    except Exception as error:  # drjit raises what it likes where LLVM is missing
        print(f"llvm_ad_rgb is left out: {error}", file=sys.stderr)
    mi.set_variant("scalar_rgb")
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.out or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        cornell, scene = folder / "cornell.xml", folder / "mesh.xml"
        cornell.write_text(CORNELL.format(depth=DEPTH, side=SIDE))
        mesh = arguments.mesh or folder / "mesh.ply"
        if arguments.mesh is None:
            bumpy_sphere(mesh)
        sky(mi, folder / "sky.exr")
        eye, target_point = framing(mi, mesh)
        scene.write_text(MESH_SCENE.format(depth=DEPTH, side=SIDE, eye=eye, target=target_point, mesh=mesh.resolve()))
        rows = {
            "cornell": compare("Cornell box", cornell, arguments.server, variants, arguments.repeat),
            "mesh": compare(f"{mesh.name} under a sky with a sun", scene, arguments.server, variants, arguments.repeat),
        }
        (folder / "figures.json").write_text(json.dumps(rows, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
