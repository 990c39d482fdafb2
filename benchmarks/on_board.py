"""What localizing alone needs on a robot's computer: answers without poselib beside those with it, disk and memory.

    OMP_NUM_THREADS=1 python benchmarks/on_board.py [--write]

poselib has no wheel for ARM64 Linux; `rholoc.geometry.opencv_ransac` takes its place there. The kitchen's frames are
asked in the kitchen's map in one process with poselib and in another without, and pictures of other rooms, which must
be refused. Disk is the size of the files in all wheels that `pip install rholoc` takes; memory is that of `rholoc
track` at its peak. `--write` keeps the figures in `benchmarks/results/onboard.json`.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
import tomllib
import zipfile
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

from figures import Figure, Figures, write_results
from measuring import SHARED_DATA

ROOT = Path(__file__).parents[1]
ASKED = {"kitchen, easy": "easy", "kitchen, hard": "hard", "kitchen, map 700–999": "afar"}
NOISE = {  # and whether more is better
    "frames": (0, True), "within_5cm": (2, True), "wrong": (0, False), "median_cm": (0.2, False), "cpu_ms": (30, False),
    "localized": (0, False),
}  # fmt: skip
STRANGERS_EACH = 6
LARGE = ("scipy", "opencv_python_headless", "numpy", "faiss_cpu")
FEATURES = "sift48"


def answers(with_poselib: bool, kept: Path) -> dict[str, Any]:
    """Figures of all frames, in this process."""
    import numpy as np

    from rholoc.geometry import pose_distances, resection
    from rholoc.localization import Query, localizer_of
    from rooms import ROOMS, map_of, strangers

    if not with_poselib:
        resection.poselib = None
    found: dict[str, Any] = {}
    for named in (one for one in ROOMS if one.name in ASKED):
        room = named.make(kept)
        localizer = localizer_of(map_of(named, room.mapped, FEATURES, kept))
        assert room.asked.camera is not None
        errors, taken_s = [], []
        for T, image in room.pictures():
            begun = time.process_time()
            answer = localizer.localize(Query.of_picture(image, localizer.extractor, room.asked.camera))
            taken_s.append(time.process_time() - begun)
            apart = (np.inf, np.inf) if answer.pose is None else pose_distances(answer.pose.T_map_camera, T)
            errors.append([float(one) for one in apart])
        metres, radians = np.array(errors).T
        found[ASKED[named.name]] = {
            "frames": len(errors),
            "within_5cm": int(((metres < 0.05) & (radians < np.radians(5))).sum()),
            "wrong": int((np.isfinite(metres) & (metres > 0.5)).sum()),
            "median_cm": round(100 * float(np.median(metres)), 2),
            "cpu_ms": round(1000 * float(np.median(taken_s))),
        }
        if ASKED[named.name] == "easy":
            others = [
                localizer.localize(Query.of_picture(image, localizer.extractor, camera)).localized
                for image, camera in strangers("redkitchen", STRANGERS_EACH)
            ]
            found["strangers"] = {"frames": len(others), "localized": sum(others)}
    return found


def peak_mb(kept: Path) -> float:
    """Memory of ``rholoc track`` in the kitchen's map at its peak."""
    map_file = next((kept / "maps").glob("kitchen-400-*.rho"))
    arguments = [str(map_file), str(SHARED_DATA / "redkitchen"), "--frames", "200:400"]
    code = f"""
import sys, typer
from rholoc.cli.track import track  # by itself: the laboratory's commands are not on a robot
app = typer.Typer()
app.command()(track)
app({arguments!r}, standalone_mode=False)
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(int(peak.split()[1]) / 1024, file=sys.stderr)
"""
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return float(ran.stderr.split()[-1])


def installed_mb() -> dict[str, float]:
    """Disk that localizing needs on this machine and on ARM64 Linux, MB: files of all wheels, unpacked.

    And that of the four largest packages on ARM64 Linux.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = {}
    for machine in ("x86_64", "aarch64"):
        wanted = [Requirement(text) for text in project["dependencies"]]
        names = [
            f"{one.name}{one.specifier}"
            for one in wanted
            if one.name != "rholoc-client"
            and (one.marker is None or one.marker.evaluate({"platform_machine": machine}))
        ]
        with tempfile.TemporaryDirectory() as folder:
            pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
            subprocess.run([*pip, "wheel", "--no-deps", "-w", folder, ROOT / "client", ROOT], check=True)
            platforms = [f"--platform=manylinux_2_{minor}_{machine}" for minor in (28, 27, 26, 24, 17)]
            platforms.append(f"--platform=manylinux2014_{machine}")
            only = ["--only-binary=:all:", "--python-version=3.11", "--abi=cp311", "--abi=abi3", "--abi=none"]
            constraints = ["-c", str(ROOT / "server" / "constraints.txt"), "httpx", *names]
            subprocess.run([*pip, "download", "-d", folder, *platforms, *only, *constraints], check=True)
            sizes = {wheel.name.partition("-")[0]: _unpacked_mb(wheel) for wheel in Path(folder).glob("*.whl")}
        found[machine] = sum(sizes.values())
    return found | {f"{machine}_{name.partition('_')[0]}": sizes[name] for name in LARGE}


def _unpacked_mb(wheel: Path) -> float:
    return sum(file.file_size for file in zipfile.ZipFile(wheel).infolist()) / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--kept", type=Path, default=Path(tempfile.gettempdir()) / "rholoc-rooms")
    parser.add_argument("--answers", choices=["with", "without"])
    options = parser.parse_args()
    options.kept.mkdir(exist_ok=True)
    if options.answers:
        print(json.dumps(answers(options.answers == "with", options.kept)))
        return
    figures: Figures = {}
    for which in ("with", "without"):
        command = [sys.executable, __file__, "--answers", which, "--kept", options.kept]
        ran = subprocess.run(command, check=True, capture_output=True, text=True)
        for name, found in json.loads(ran.stdout).items():
            for figure, value in found.items():
                figures[f"onboard.{which}.{name}.{figure}"] = Figure(value, *NOISE[figure])
    figures["onboard.peak_mb"] = Figure(round(peak_mb(options.kept)), 10, False)
    for machine, size_mb in installed_mb().items():
        figures[f"onboard.{machine}_mb"] = Figure(round(size_mb), 10, False)
    for name, one in figures.items():
        print(name, one.value)
    if options.write:
        write_results("onboard", figures, "python benchmarks/on_board.py --write")


if __name__ == "__main__":
    main()
