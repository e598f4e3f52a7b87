#!/usr/bin/env python3
"""Speed of the march through a CT beside VTK's ray cast on the CPU, in one run.

    python3 -m venv env && env/bin/pip install vtk==9.7.2 numpy
    cargo bench -p warplight-server --bench layers --no-run
    WARPLIGHT_DATA=FOLDER env/bin/python tests/against_vtk.py --bench target/release/deps/layers-HASH [--repeat N] [--threads N]

Both show the torso of WARPLIGHT_DATA at 1024x1024 from the same place with the same transfer points, and take turns. VTK's
time is that of `vtkFixedPointVolumeRayCastMapper` alone (its own clock, `GetTimeToDraw`, the picture not handed to
OpenGL again), with steps of half a voxel and no automatic coarsening; off-screen, without shading. Ours is the march of
`cargo bench --bench layers`: slices of every ray, ready to be cut.

What differs, so that nobody reads more into it: VTK stops where a ray is opaque, the march goes right through, since other
views see what is behind; VTK's samples are fixed-point with 15 bits and post-classified, ours are floats, pre-integrated;
VTK has no light inside of the medium here, ours looks it up.
"""

import argparse
import os
import re
import statistics
import subprocess
import sys
import time
from pathlib import Path

SIDE = 1024
EYE, FOV_DEG, SIZE_M = (1.6, 1.0, -4.4), 38.0, (2.0, 1.84, 1.66)
# Value, colour, extinction per metre: as in server/benches/layers.rs.
TRANSFER = [
    (-200, (0.9, 0.7, 0.45), 0.0), (-120, (0.95, 0.8, 0.5), 0.5), (-60, (0.95, 0.8, 0.5), 0.5),
    (-10, (0.8, 0.3, 0.2), 1.2), (60, (0.8, 0.25, 0.2), 2.0), (130, (0.85, 0.5, 0.4), 3.0),
    (200, (0.95, 0.9, 0.8), 18.0), (500, (1.0, 0.97, 0.9), 60.0), (1200, (0.9, 0.95, 1.0), 90.0),
]  # fmt: skip


def vtk_view(vtk, file: Path, threads: int):
    """A window that shows the CT, and its mapper."""
    import math

    reader = vtk.vtkNrrdReader()
    reader.SetFileName(str(file))
    reader.Update()
    image = reader.GetOutput()
    # The volume's z is up: x, z, -y of its own axes are x, y, z of the world, and it is centred.
    cells = image.GetDimensions()
    extent = (SIZE_M[0], SIZE_M[2], SIZE_M[1])
    spacing = [length / count for length, count in zip(extent, cells)]
    image.SetSpacing(spacing)
    image.SetOrigin([-0.5 * step * (count - 1) for step, count in zip(spacing, cells)])
    image.SetDirectionMatrix(1, 0, 0, 0, 1, 0, 0, 0, 1)
    # Fixed-point casting takes unsigned numbers best: it shifts and scales by itself.
    color, opacity = vtk.vtkColorTransferFunction(), vtk.vtkPiecewiseFunction()
    unit_m = 0.5 * min(spacing)
    for value, rgb, extinction in TRANSFER:
        color.AddRGBPoint(value, *rgb)
        opacity.AddPoint(value, 1.0 - math.exp(-extinction * unit_m))
    matter = vtk.vtkVolumeProperty()
    matter.SetColor(color)
    matter.SetScalarOpacity(opacity)
    matter.SetScalarOpacityUnitDistance(unit_m)
    matter.SetInterpolationTypeToLinear()
    matter.ShadeOff()
    mapper = vtk.vtkFixedPointVolumeRayCastMapper()
    mapper.SetInputData(image)
    mapper.AutoAdjustSampleDistancesOff()
    mapper.LockSampleDistanceToInputSpacingOff()
    mapper.SetSampleDistance(unit_m)
    mapper.SetInteractiveSampleDistance(unit_m)
    mapper.SetImageSampleDistance(1.0)
    mapper.SetNumberOfThreads(threads)
    volume = vtk.vtkVolume()
    volume.SetMapper(mapper)
    volume.SetProperty(matter)
    volume.RotateX(-90.0)
    scene = vtk.vtkRenderer()
    scene.AddVolume(volume)
    camera = scene.GetActiveCamera()
    camera.SetPosition(*EYE)
    camera.SetFocalPoint(0.0, 0.0, 0.0)
    camera.SetViewUp(0.0, 1.0, 0.0)
    camera.SetViewAngle(FOV_DEG)
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetSize(SIDE, SIDE)
    window.AddRenderer(scene)
    scene.ResetCameraClippingRange()
    window.Render()
    return window, mapper, scene


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", required=True, help="the program that cargo bench --bench layers --no-run names")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--picture", help="where to write what VTK shows, as PNG")
    options = parser.parse_args()
    folder = os.environ.get("WARPLIGHT_DATA")
    if not folder:
        sys.exit("WARPLIGHT_DATA: expected the folder of the CT")
    try:
        import vtk
    except ImportError as error:
        sys.exit(f"vtk: expected the package of PyPI ({error}); see the head of this file")
    window, mapper, scene = vtk_view(vtk, Path(folder) / "volumes/ct_torso_3mm.nrrd", options.threads)
    ours, theirs, whole = [], [], []
    for _ in range(options.repeat):
        # Turning the camera by nothing makes it render again.
        scene.GetActiveCamera().Modified()
        start = time.perf_counter()
        window.Render()
        whole.append(1e3 * (time.perf_counter() - start))
        theirs.append(1e3 * mapper.GetTimeToDraw())
        told = subprocess.run(
            [options.bench, "torso", "--frames", "1"],
            env=os.environ | {"RAYON_NUM_THREADS": str(options.threads)},
            check=True, capture_output=True, text=True,
        ).stdout  # fmt: skip
        ours.append(float(re.search(r"^torso\s+(\d+)", told, re.MULTILINE)[1]))
    if options.picture:
        grab, writer = vtk.vtkWindowToImageFilter(), vtk.vtkPNGWriter()
        grab.SetInput(window)
        writer.SetInputConnection(grab.GetOutputPort())
        writer.SetFileName(options.picture)
        writer.Write()
    print(f"CT torso, {SIDE}x{SIDE}, {options.threads} threads, medians of {options.repeat}, ms")
    print(f"VTK {vtk.vtkVersion().GetVTKVersion()} fixed-point ray cast {statistics.median(theirs):8.0f}")
    print(f"  with the window's work          {statistics.median(whole):8.0f}")
    print(f"march of all rays                 {statistics.median(ours):8.0f}")


if __name__ == "__main__":
    main()
