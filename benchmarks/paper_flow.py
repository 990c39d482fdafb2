"""The paper's own fit beside the other forms of its density, on the same features and matches.

    python benchmarks/paper_flow.py [--cache DIR] [--features lab3] [--queries 25] [--write]

Makes Table 4 and its map for the simulated test site (walk 1, true poses) and for redkitchen (frames 400–999, its
poses), in four forms: `ray`; `tensor`, a bump around the triangulated landmark; `observed`, loss (5) over all pixels of
the views that saw a feature; and (5) as it is printed, over the points where a feature was seen. Prints of each how far
its peaks are from the landmarks' projections, on the walk itself and on frames of another one, what (5) leaves of a
constant and of the fit, and how frames localize: by the densities alone (Figure 9), and by the whole localizer. With
`--write` the figures go to benchmarks/results/paper.json, and from there into the documents.
"""

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from figures import AGAIN_CM, FRAME_PERCENT, Figure, Figures, quote_anew, write_results
from measuring import SHARED_DATA
from rholoc.density import DensityKind, TensorDensities
from rholoc.features import FeatureSet, get_extractor
from rholoc.geometry import Camera, FloatArray, pose_distances
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping.build.density_fitting import DEFAULT_DEGREE, fit_densities, ray_form, sightings_of
from rholoc.maps import Map
from rholoc.paper.density_localizer import DensityLocalizer
from rholoc.recordings import Recording, read_recording
from rholoc.simulation import simulate_recording
from rholoc.trajectory import PoseMethod
from rholoc_lab.evaluation.splits import with_poses
from rholoc_lab.paper.from_observations import FitOptions, fit_figures, map_from_observations
from rholoc_lab.paper.observing import observe_recording
from rholoc_lab.paper.printed_loss import fit_seen

KITCHEN_CAMERA = "525.505,525.505,320,240"
PRINTED = "as printed"
FORMS = ("ray", "tensor", "observed", PRINTED)


def simulated(cache: Path) -> tuple[Recording, dict[str, Recording]]:
    """Walk 1 of the test site, and frames of it and of walk 2."""
    for walk in (1, 2):
        if not (cache / f"s0w{walk}").is_dir():
            simulate_recording(cache / f"s0w{walk}", walk=walk)
    frames = {"the walk": ("s0w1", "7:900:30"), "another walk": ("s0w2", "0:900:30")}
    first = with_poses(read_recording(cache / "s0w1"), use_truth=True)
    return first, {
        label: with_poses(read_recording(cache / name, frames=rows), use_truth=True)
        for label, (name, rows) in frames.items()
    }


def kitchen() -> tuple[Recording, dict[str, Recording]]:
    """Frames 400–999 of redkitchen, and frames of them, easy ones and hard ones."""

    def read(frames: str) -> Recording:
        return with_poses(read_recording(SHARED_DATA / "redkitchen", camera=KITCHEN_CAMERA, frames=frames), False)

    return read("400:1000:2"), {
        "the walk": read("401:1000:24"),
        "easy": read("200:400:8"),
        "hard": read("100:200:4"),
    }


def forms_of(recording: Recording, features: str) -> dict[str, Map]:
    """The map of one recording's Table 4 in every form."""
    table, camera = observe_recording(recording, features, PoseMethod.GIVEN)
    print(f"  Table 4: {len(table)} observations", flush=True)
    options = FitOptions(report=False, features=features)
    map_ = map_from_observations(table, camera, recording.name, replace(options, density=DensityKind.RAY))
    info = replace(map_.info, density=DensityKind.OBSERVED)
    printed = replace(map_, info=info, densities=fit_seen(sightings_of(map_), DEFAULT_DEGREE))
    fitted = [fit_densities(ray_form(map_), kind) for kind in (DensityKind.TENSOR, DensityKind.OBSERVED)]
    return dict(zip(FORMS, (map_, *fitted, printed), strict=True))


def peak_offsets_px(map_: Map, T_map_camera: FloatArray, camera: Camera) -> FloatArray:
    """How far the peaks of the densities that are valid at poses (N, 4, 4) are from where landmarks appear; ∞: none."""
    densities, found = map_.densities, [np.zeros(0)]
    if not isinstance(densities, TensorDensities):
        return found[0]
    landmarks = map_.landmarks.positions.astype(np.float64)
    for T in T_map_camera:
        features, rows = densities.choose(np.arange(len(map_)), T)
        seen = (landmarks[features] - T[:3, 3]) @ T[:3, :3]
        visible = np.flatnonzero((seen[:, 2] > 0.2) & camera.contains(camera.project(seen)))
        plane = seen[visible, :2] / seen[visible, 2:]
        peaks = densities.take(rows[visible]).at(plane, T)
        found.append(np.where(peaks.peaked, camera.focal * np.linalg.norm(peaks.offset, axis=1), np.inf))
    return np.concatenate(found)


def answers(map_: Map, frames: list[FeatureSet], camera: Camera, whole: bool) -> Iterator[FloatArray | None]:
    """The poses (4, 4) of frames, by the whole localizer or by the densities alone."""
    if whole:
        localizer = Localizer(map_)
        for features in frames:
            pose = localizer.localize(Query(features, camera, Dof.FREE)).pose
            yield None if pose is None else pose.T_map_camera
    else:
        alone = DensityLocalizer(map_)
        for features in frames:
            ascent = alone.localize(features, camera)
            yield None if ascent is None else ascent.optimum.T_map_camera


def recall(found: list[FloatArray | None], truth: FloatArray) -> dict[str, float]:
    """Median errors and shares within limits; a frame without a pose counts as infinitely wrong."""
    wrong = (np.inf, np.inf)
    pairs = zip(found, truth, strict=True)
    errors = np.array([wrong if T is None else tuple(map(float, pose_distances(T, t))) for T, t in pairs])
    cm, deg = 100 * errors[:, 0], np.degrees(errors[:, 1])
    within = [100 * float(np.mean((cm < limit) & (deg < turned))) for limit, turned in ((5, 5), (25, 10))]
    return {
        "median_cm": float(np.median(cm)),
        "median_deg": float(np.median(deg)),
        "percent": within[0],
        "percent_25cm": within[1],
    }


def figure_of(name: str, value: float) -> Figure:
    """A figure with its noise: two frames of a hundred where it is a share, a millimetre or a pixel otherwise."""
    share = "percent" in name
    return Figure(round(value, 4 if "loss" in name else 1), FRAME_PERCENT if share else AGAIN_CM, share)


def main() -> None:
    parser = argparse.ArgumentParser(description="The paper's own fit beside the other forms of its density.")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "sim")
    parser.add_argument("--features", default="lab3")
    parser.add_argument("--queries", type=int, default=25, help="of each set, at most")
    parser.add_argument("--write", action="store_true", help="put the figures into the documents")
    args = parser.parse_args()
    extractor = get_extractor(args.features)
    measured: dict[str, float] = {}
    for name, (recording, queries) in (("test site", simulated(args.cache)), ("redkitchen", kitchen())):
        print(name)
        maps = forms_of(recording, args.features)
        for form, map_ in maps.items():
            figures = fit_figures(map_, seen_only=form == PRINTED)
            if figures is not None:
                where = f"paper.{name.split()[-1]}.{form.split()[-1]}"
                measured[f"{where}.loss_of_a_constant"] = figures.constant_share
                measured[f"{where}.loss_of_the_fit"] = figures.fitted_share
                measured[f"{where}.peaked_percent"] = 100 * figures.peaked_share
                print(
                    f"  {form:10} {len(map_)} features, {figures.densities} densities of {figures.observations:.0f} "
                    f"observations (median); N_f {figures.points:.0f}; of (5) a constant leaves "
                    f"{figures.constant_share:.3f}, the fit {figures.fitted_share:.4f}; "
                    f"{100 * figures.peaked_share:.0f} % have a peak",
                    flush=True,
                )
        for label, asked in queries.items():
            assert asked.poses is not None
            assert asked.camera is not None
            count = len(asked.frames.times)
            rows = np.unique(np.linspace(0, count - 1, min(args.queries, count)).astype(np.int64))
            truth = asked.poses.T_map_camera[rows]
            frames = [extractor.extract(image) for image in asked.frames.images(rows.tolist())]
            print(f"  {label}, {len(frames)} frames; shares within 5 cm and 5°, and 25 cm and 10°")
            for form, map_ in maps.items():
                off_px = peak_offsets_px(map_, truth, asked.camera)
                peaks = f"{np.median(off_px):6.1f} px" if len(off_px) else "    exact"
                where = f"paper.{name.split()[-1]}.{label.replace(' ', '_')}.{form.split()[-1]}"
                if len(off_px):
                    measured[f"{where}.peaks_px"] = float(np.median(off_px))
                for whole in (False, True):
                    how, found = "whole" if whole else "alone", list(answers(map_, frames, asked.camera, whole))
                    shares = recall(found, truth)
                    measured |= {f"{where}.{how}_{title}": value for title, value in shares.items()}
                    line = "  ".join(f"{title} {value:.2f}" for title, value in shares.items())
                    print(f"    {form:10} {how:6} {peaks}   {line}", flush=True)
    if args.write:
        kept: Figures = {title: figure_of(title, value) for title, value in measured.items() if np.isfinite(value)}
        write_results("paper", kept, "python benchmarks/paper_flow.py --write")
        quote_anew()


if __name__ == "__main__":
    main()
