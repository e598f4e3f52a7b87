#!/usr/bin/env python3
"""Does mode `specular` beat the baselines where a picture shows mirrors, water or glass?

    cargo build --release
    tests/specular_against_baselines.py [--scenes gallery,pool] [--traces built-in,F.tum] [--latencies 20,200] [--out FOLDER]

Replays each head trace in each scene over a link of each latency, in virtual time, and compares every mode with
converged renderings of the displayed poses, over the pixels that show a specular surface. A cell is one replay. Its
report.json stays in the folder, so that an interrupted run goes on where it was; a cell whose settings or whose client
program differ is replayed anew. Writes a table for each scene to stdout and to table.md in the folder. Exits with 1 if
a cell fails, and not because one is lost: that is a result.

Needs nothing but Python. With WARPLIGHT_DATA a recorded trace is used beside the built-in one.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

SCENES = ["gallery", "chrome", "pool", "glass"]
LATENCIES_MS = [20, 50, 100, 200]
RECORDED = ["vr90_fast_turns"]
# Name, place in a report, whether more is better, decimals.
METRICS = [("PSNR", "psnr_db", True, 2), ("DSSIM", "dssim", False, 4), ("FLIP", "flip", False, 4)]
DISPLAY_HZ = 60


def traces(names: str) -> list[tuple[str, Path | None]]:
    """Name and file; the built-in trace has none."""
    if names:
        return [(Path(name).stem, None if name == "built-in" else Path(name)) for name in names.split(",")]
    found: list[tuple[str, Path | None]] = [("built-in", None)]
    folder = os.environ.get("WARPLIGHT_DATA")
    if folder is None:
        print("WARPLIGHT_DATA is not set: no recorded head trace, the built-in one alone", file=sys.stderr)
        return found
    return found + [(name, Path(folder) / "traces" / f"{name}.tum") for name in RECORDED]


def command_of(arguments, scene: str, trace: Path | None, latency_ms: float) -> list[str]:
    every = max(1, int(arguments.duration_s * DISPLAY_HZ / arguments.comparisons))
    command = ["replay", "--clock", "virtual", "--scene", scene, "--latency-ms", str(latency_ms)]
    command += ["--size", arguments.size, "--duration-s", str(arguments.duration_s), "--frame-hz", "5"]
    command += ["--display-hz", str(DISPLAY_HZ), "--spp", str(arguments.spp), "--seed", str(arguments.seed)]
    command += ["--quality-every", str(every), "--quality-spp", str(arguments.quality_spp)]
    if arguments.modes:
        command += ["--modes", arguments.modes]
    if trace is not None:
        command += ["--trace", str(trace)]
    return command


def replay(client: Path, program: str, command: list[str], folder: Path) -> tuple[dict, float]:
    """The report of a cell, and the seconds it took; 0 where it was there."""
    report, settings = folder / "report.json", folder / "settings.json"
    wanted = json.dumps({"client": program, "command": command}, indent=1)
    if report.is_file() and settings.is_file() and settings.read_text() == wanted:
        return json.loads(report.read_text()), 0.0
    folder.mkdir(parents=True, exist_ok=True)
    settings.unlink(missing_ok=True)
    start = time.monotonic()
    done = subprocess.run([str(client), *command, "--out", str(folder)], capture_output=True, text=True)
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise RuntimeError(f"{folder.name}: exit status {done.returncode}: {last}")
    # Last, so that it stands for a whole report.
    settings.write_text(wanted)
    return json.loads(report.read_text()), time.monotonic() - start


def median(row: dict, metric: str) -> float | None:
    return row[metric]["p50"] if row.get(metric) else None


class Cell:
    """One replay, read."""

    def __init__(self, trace: str, latency_ms: float, report: dict):
        self.trace, self.latency_ms, self.report = trace, latency_ms, report
        self.rows = {row["mode"]: row for row in report["quality"]}
        self.modes = list(self.rows)
        self.specular = {mode: row.get("specular") or {} for mode, row in self.rows.items()}

    def winner(self, metric: str, more: bool) -> str | None:
        known = {mode: median(row, metric) for mode, row in self.specular.items()}
        known = {mode: value if more else -value for mode, value in known.items() if value is not None}
        return max(known, key=known.get) if known else None

    def losses(self) -> list[str]:
        """Metrics in which another mode is better than `specular`, by how much."""
        lost = []
        for name, metric, more, decimals in METRICS:
            best = self.winner(metric, more)
            if best not in (None, "specular") and "specular" in self.rows:
                off = median(self.specular["specular"], metric) - median(self.specular[best], metric)
                if off != 0:
                    lost.append(f"{name} to `{best}` by {abs(off):.{decimals}f}")
        return lost


def number(value: float | None, decimals: int, sign: bool = False) -> str:
    return "–" if value is None else f"{value:{'+' if sign else ''}.{decimals}f}"


def table(scene: str, cells: list[Cell]) -> list[str]:
    modes = cells[0].modes
    heads = ["trace", "ms each way", "pixels", *modes, "best", "whole picture: specular - diffuse"]
    lines = [f"## {scene}", "", "| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for cell in cells:
        shown = [cell.trace, f"{cell.latency_ms:g}"]
        fraction = median(cell.specular[modes[-1]], "pixel_fraction")
        shown.append("none" if fraction is None else f"{100 * fraction:.0f} %")
        for mode in modes:
            shown.append(" / ".join(number(median(cell.specular[mode], m), d) for _, m, _, d in METRICS))
        winners = [cell.winner(metric, more) or "–" for _, metric, more, _ in METRICS]
        best = winners[0] if len(set(winners)) == 1 else " / ".join(winners)
        shown.append(f"{best} **lost**" if cell.losses() else best)
        whole = []
        for _, metric, _, decimals in METRICS:
            pair = [median(cell.rows.get(mode, {}), metric) for mode in ("specular", "diffuse")]
            whole.append(number(None if None in pair else pair[0] - pair[1], decimals, sign=True))
        shown.append(" / ".join(whole))
        lines.append("| " + " | ".join(shown) + " |")
    return lines + [""]


def noise(cells: list[Cell]) -> str:
    """How good the references are, in the pixels that count."""
    found = [(cell.report.get("reference") or {}).get("specular_noise_psnr_db") for cell in cells]
    known = sorted(value for value in found if value is not None)
    return f"{known[0]:.1f} to {known[-1]:.1f} dB" if known else "not measured"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    root = Path(__file__).resolve().parent.parent
    target = Path(os.environ.get("CARGO_TARGET_DIR", root / "target"))
    parser.add_argument("--client", type=Path, default=target / "release/warplight-client")
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--traces", default="", help="built-in, or TUM files, by commas")
    parser.add_argument("--latencies", default=",".join(map(str, LATENCIES_MS)), help="milliseconds each way")
    parser.add_argument("--size", default="256x256")
    parser.add_argument("--duration-s", type=float, default=6)
    parser.add_argument("--comparisons", type=int, default=4, help="compared refreshes in each replay")
    parser.add_argument("--spp", type=int, default=4, help="samples per pixel of live frames")
    parser.add_argument("--quality-spp", type=int, default=128, help="samples per pixel of the references")
    parser.add_argument("--modes", default="", help="modes to compare, by commas; all by default")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/specular-against-baselines"))
    arguments = parser.parse_args()
    if not arguments.client.is_file():
        parser.error(f"{arguments.client}: not there; build it by `cargo build --release`, or name it by --client")
    program = hashlib.sha256(arguments.client.read_bytes()).hexdigest()[:16]
    latencies = [float(text) for text in arguments.latencies.split(",")]
    chosen = traces(arguments.traces)

    lines = ["# Mode `specular` against the baselines", ""]
    lines += ["Medians over the pixels of the references that show a mirror, water or glass: PSNR in dB / DSSIM / FLIP.", ""]
    every_cell, lost, failed, spent = [], [], [], 0.0
    for scene in arguments.scenes.split(","):
        cells = []
        for name, path in chosen:
            for latency_ms in latencies:
                folder = arguments.out / f"{scene}-{name}-{latency_ms:g}ms"
                try:
                    report, seconds = replay(arguments.client, program, command_of(arguments, scene, path, latency_ms), folder)
                except (RuntimeError, OSError, json.JSONDecodeError) as error:
                    failed.append(str(error))
                    print(f"failed: {error}", file=sys.stderr)
                    continue
                spent += seconds
                cell = Cell(name, latency_ms, report)
                cells.append(cell)
                losses = cell.losses()
                lost += [f"- {scene}, {name}, {latency_ms:g} ms: {', '.join(losses)}"] if losses else []
                print(f"{scene}, {name}, {latency_ms:g} ms: {seconds:.0f} s", file=sys.stderr, flush=True)
        if cells:
            lines += table(scene, cells)
        every_cell += cells
    lines += [f"{len(every_cell)} cells, {len(lost)} lost in one metric or more, {len(failed)} failed.", ""]
    lines += (["Lost:", ""] + lost + [""]) if lost else []
    lines += (["Failed:", ""] + [f"- {error}" for error in failed] + [""]) if failed else []
    lines += [f"Two references of one pose by different samples differ by {noise(every_cell)} in those pixels.", ""]
    lines += ["```", "tests/specular_against_baselines.py " + " ".join(sys.argv[1:]), "```"]
    arguments.out.mkdir(parents=True, exist_ok=True)
    text = "\n".join(lines) + "\n"
    (arguments.out / "table.md").write_text(text)
    print(text)
    print(f"{spent:.0f} s of replays", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
