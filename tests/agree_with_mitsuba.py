#!/usr/bin/env python3
"""Do `warplight-server render` and Mitsuba 3 agree, material by material and light by light?

    python3 -m venv env && env/bin/pip install mitsuba==3.9.1 numpy
    cargo build --release -p warplight-server
    env/bin/python tests/agree_with_mitsuba.py [--server PATH] [--only NAME] [--spp N] [--out FOLDER]

Every scene is one XML file that both read. Each renders it with several seeds; the scatter of the seeds is the
error. Agreement is a hypothesis test: the difference of the means over blocks of 8x8 pixels over its standard error
(Student's t, Sidak-corrected over all blocks and channels to 0.1 %), and image means within 0.5 %. Where they
disagree, both pictures and their difference are left in the folder.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

SIDE, SEEDS, DEPTH = 96, 8, 12

SCENE = """<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
    <sensor type="perspective">
        <float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 1.6, 4.2" target="0, 0.75, 0" up="0, 1, 0"/></transform>
        <sampler type="independent"><integer name="sample_count" value="64"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="{side}"/><integer name="height" value="{side}"/><rfilter type="box"/>
        </film>
    </sensor>
    <shape type="rectangle">
        <transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform>
        <bsdf type="twosided"><bsdf type="diffuse">{floor}</bsdf></bsdf>
    </shape>
    {content}
</scene>
"""

GREY_FLOOR = '<rgb name="reflectance" value="0.5, 0.45, 0.4"/>'
CHECKER = """<texture type="checkerboard" name="reflectance">
    <rgb name="color0" value="0.1, 0.2, 0.4"/><rgb name="color1" value="0.8, 0.7, 0.6"/>
    <transform name="to_uv"><scale value="5, 3, 1"/></transform></texture>"""
BITMAP = '<texture type="bitmap" name="reflectance"><string name="filename" value="picture.png"/></texture>'
SKY = """<emitter type="envmap"><string name="filename" value="sky.exr"/>
    <transform name="to_world"><rotate x="0.6" y="0" z="0.8" angle="40"/><rotate y="1" angle="70"/></transform></emitter>"""
CONSTANT = '<emitter type="constant"><rgb name="radiance" value="0.5, 0.6, 0.8"/></emitter>'
AREA = """<shape type="rectangle"><transform name="to_world"><scale value="0.7"/><rotate x="1" angle="90"/>
    <translate value="0.5, 3, 0.3"/></transform><bsdf type="diffuse"/>
    <emitter type="area"><rgb name="radiance" value="9, 8, 7"/></emitter></shape>"""


def ball(bsdf: str) -> str:
    return f'<shape type="sphere"><point name="center" value="0, 0.8, 0"/><float name="radius" value="0.8"/>{bsdf}</shape>'


def pane(bsdf: str) -> str:
    return f"""<shape type="rectangle"><transform name="to_world"><scale value="0.9"/><rotate y="1" angle="25"/>
        <translate value="0, 0.95, 0.6"/></transform>{bsdf}</shape>"""


def conductor(kind: str, alpha: str, extra: str = "") -> str:
    return f"""<bsdf type="roughconductor"><string name="distribution" value="{kind}"/>{alpha}{extra}
        <rgb name="eta" value="0.2, 0.92, 1.1"/><rgb name="k" value="3.9, 2.45, 2.14"/></bsdf>"""


def alpha(value: float) -> str:
    return f'<float name="alpha" value="{value}"/>'


def glass(kind: str, value: float) -> str:
    return f"""<bsdf type="roughdielectric"><string name="distribution" value="{kind}"/>{alpha(value)}
        <float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/></bsdf>"""


ANISOTROPIC = '<float name="alpha_u" value="0.4"/><float name="alpha_v" value="0.1"/>'
SCENES = {
    "diffuse, area light": (CHECKER, ball('<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.3, 0.2"/></bsdf>') + AREA),
    "bitmap, constant sky": (BITMAP, ball('<bsdf type="diffuse"/>') + CONSTANT),
    "turned environment": (GREY_FLOOR, ball('<bsdf type="diffuse"/>') + SKY),
    "point light": (GREY_FLOOR, ball('<bsdf type="diffuse"/>') + '<emitter type="point"><point name="position" value="1.5, 2.5, 1"/><rgb name="intensity" value="9, 8, 7"/></emitter>'),
    "spot light": (CHECKER, ball('<bsdf type="diffuse"/>') + '<emitter type="spot"><rgb name="intensity" value="20, 18, 16"/><float name="cutoff_angle" value="30"/><float name="beam_width" value="12"/><transform name="to_world"><lookat origin="1.5, 3, 1.5" target="0, 0.5, 0" up="0, 1, 0"/></transform></emitter>'),
    "directional light": (GREY_FLOOR, ball('<bsdf type="diffuse"/>') + '<emitter type="directional"><vector name="direction" value="-0.5, -1, -0.4"/><rgb name="irradiance" value="3, 2.8, 2.5"/></emitter>'),
    "smooth copper": (CHECKER, ball(conductor("ggx", alpha(0.0001)).replace('type="roughconductor"', 'type="conductor"').replace(alpha(0.0001), "").replace('<string name="distribution" value="ggx"/>', "")) + SKY),
    "smooth glass": (CHECKER, ball('<bsdf type="dielectric"><float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/></bsdf>') + CONSTANT),
    "thin glass": (CHECKER, pane('<bsdf type="thindielectric"><float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/></bsdf>') + CONSTANT),
    "ggx copper 0.05": (CHECKER, ball(conductor("ggx", alpha(0.05))) + SKY),
    "ggx copper 0.3": (CHECKER, ball(conductor("ggx", alpha(0.3))) + AREA),
    "ggx copper 0.9": (CHECKER, ball(conductor("ggx", alpha(0.9))) + AREA),
    "beckmann copper 0.1": (CHECKER, ball(conductor("beckmann", alpha(0.1))) + SKY),
    "beckmann copper 0.5": (CHECKER, ball(conductor("beckmann", alpha(0.5))) + AREA),
    "anisotropic ggx copper": (CHECKER, ball(conductor("ggx", ANISOTROPIC)) + AREA),
    "ggx glass 0.05": (CHECKER, ball(glass("ggx", 0.05)) + CONSTANT),
    "ggx glass 0.4": (CHECKER, ball(glass("ggx", 0.4)) + AREA + CONSTANT),
    "beckmann glass 0.1": (CHECKER, ball(glass("beckmann", 0.1)) + CONSTANT),
    "beckmann glass 0.5": (CHECKER, ball(glass("beckmann", 0.5)) + AREA + CONSTANT),
    "cutout": (CHECKER, pane('<bsdf type="mask"><float name="opacity" value="0.3"/><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf>') + AREA),
}


def pictures(mi, folder: Path) -> None:
    """What the scenes show: a sky with two suns, and an asymmetric picture."""
    v, u = np.meshgrid(np.linspace(0, 1, 64), np.linspace(0, 1, 128), indexing="ij")
    image = np.stack([0.3 + 0.5 * v, 0.4 + 0.2 * u, 0.9 - 0.6 * v], -1).astype(np.float32)
    image[10:13, 20:24] = [40, 30, 20]
    image[25:30, 90:95] = [5, 15, 25]
    mi.Bitmap(image).write(str(folder / "sky.exr"))
    v, u = np.meshgrid(np.linspace(0, 1, 32), np.linspace(0, 1, 32), indexing="ij")
    picture = np.stack([u, v, 0.5 * (u > v)], -1)
    mi.Bitmap((255 * (0.1 + 0.8 * picture)).astype(np.uint8)).write(str(folder / "picture.png"))


def blocks(image: np.ndarray) -> np.ndarray:
    return image.reshape(SIDE // 8, 8, SIDE // 8, 8, 3).mean(axis=(1, 3)).reshape(-1)


def critical_t(tests: int, freedom: float, level: float = 1e-3) -> float:
    """Two-sided, Sidak-corrected; Cornish-Fisher from normal to Student."""
    two_sided = 1 - (1 - level) ** (1 / tests)
    from statistics import NormalDist

    z = NormalDist().inv_cdf(1 - two_sided / 2)
    return z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)


def ours(mi, server: str, scene: Path, seed: int, spp: int) -> np.ndarray:
    out = scene.with_suffix(".ours.exr")
    command = [server, "render", str(scene), "-o", str(out), "--spp", str(spp), "--seed", str(seed)]
    subprocess.run(command, check=True, capture_output=True)
    bitmap = mi.Bitmap(str(out)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32)
    return np.array(bitmap).astype(np.float64)


def theirs(mi, scene, seed: int, spp: int) -> np.ndarray:
    return np.array(mi.render(scene, spp=spp, seed=seed))[..., :3].astype(np.float64)


def agree(mi, name: str, scene: Path, server: str, spp: int, out: Path) -> bool:
    loaded = mi.load_file(str(scene))
    pictures_of = {
        "warplight": np.array([ours(mi, server, scene, seed, spp) for seed in range(1, SEEDS + 1)]),
        "mitsuba": np.array([theirs(mi, loaded, 100 + seed, spp) for seed in range(SEEDS)]),
    }
    means = {key: np.array([blocks(image) for image in images]) for key, images in pictures_of.items()}
    difference = means["warplight"].mean(0) - means["mitsuba"].mean(0)
    variance = sum(values.var(0, ddof=1) / SEEDS for values in means.values())
    # Arithmetic in f32 and textures in 8 bits: a tenth of a percent is no disagreement.
    systematic = 1e-3 * means["mitsuba"].mean(0)
    # Where both are black there is no error to divide by.
    error = np.sqrt(variance + systematic**2)
    worst = float(np.max(np.abs(difference) / np.maximum(error, 1e-9)))
    whole = {key: values.reshape(SEEDS, -1, 3).mean(axis=(0, 1)) for key, values in means.items()}
    off = float(np.max(np.abs(whole["warplight"] / whole["mitsuba"] - 1)))
    limit = critical_t(difference.size, SEEDS - 1)
    good = worst < limit and off < 0.005
    print(f"| {name:24} | {worst:6.2f} | {limit:6.2f} | {off * 100:6.3f}% | {'agrees' if good else 'DISAGREES'} |", flush=True)
    if not good:
        for key, images in pictures_of.items():
            mi.Bitmap(images.mean(0).astype(np.float32)).write(str(out / f"{scene.stem}.{key}.exr"))
        error = np.abs(pictures_of["warplight"].mean(0) - pictures_of["mitsuba"].mean(0))
        mi.Bitmap(error.astype(np.float32)).write(str(out / f"{scene.stem}.error.exr"))
    return good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    root = Path(__file__).resolve().parent.parent
    target = Path(os.environ.get("CARGO_TARGET_DIR", root / "target"))
    parser.add_argument("--server", default=str(target / "release/warplight-server"))
    parser.add_argument("--only", default="", help="scenes whose name holds this")
    parser.add_argument("--spp", type=int, default=256)
    parser.add_argument("--out", type=Path, help="where scenes and pictures that disagree are left")
    arguments = parser.parse_args()
    import mitsuba as mi

    try:
        mi.set_variant("llvm_ad_rgb")
        mi.load_dict({"type": "sphere"})
    except Exception:  # drjit raises what it likes where LLVM is missing
        mi.set_variant("scalar_rgb")
    print(f"Mitsuba {mi.__version__}, {mi.variant()}; {SIDE}x{SIDE}, {SEEDS} seeds of {arguments.spp} samples each\n")
    print(f"| {'scene':24} | {'|t|':>6} | limit  | image   | result |")
    print(f"|{'-' * 26}|-------:|-------:|--------:|--------|")
    results = []
    with tempfile.TemporaryDirectory() as temporary:
        out = arguments.out or Path(temporary)
        out.mkdir(parents=True, exist_ok=True)
        pictures(mi, out)
        for name, (floor, content) in SCENES.items():
            if arguments.only in name:
                scene = out / (name.replace(" ", "_").replace(",", "") + ".xml")
                text = SCENE.format(depth=DEPTH, side=SIDE, floor=floor, content=content)
                # Mitsuba's `path` loses light at masks (half of it here); its `volpath` does not.
                scene.write_text(text.replace('type="path"', 'type="volpath"') if name == "cutout" else text)
                results.append(agree(mi, name, scene, arguments.server, arguments.spp, out))
    print(f"\n{sum(results)} of {len(results)} scenes agree")
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
