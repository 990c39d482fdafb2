"""``rholoc evaluate``: a trajectory against the truth."""

from pathlib import Path
from typing import Annotated

import typer

from rholoc.cli import options
from rholoc.cli.console import print_figures, print_json, print_notice


def evaluate(
    trajectory: Annotated[
        Path, typer.Argument(metavar="TRAJECTORY", help="Estimated poses: CSV of rholoc localize (Table 6).")
    ],
    truth: Annotated[
        Path,
        typer.Argument(
            metavar="TRUTH", help="True poses: poses.txt (frame or time, tx ty tz qx qy qz qw) or Table 6 CSV."
        ),
    ],
    frames: options.Frames = None,
    align: Annotated[
        bool,
        typer.Option("--align", help="First turn and shift it into the truth's frame."),
    ] = False,
    as_json: options.Json = False,
) -> None:
    """Measure a trajectory: medians, 90th percentiles and recall.

    Every frame that has a true pose counts, or every one in --frames; those without an estimated pose are failures.
    """
    from rholoc.evaluation import evaluate as figures_of
    from rholoc.evaluation import pair_poses, read_frame_poses, rigid_alignment, trajectory_errors
    from rholoc.recordings import parse_frame_slice

    pairs = pair_poses(
        read_frame_poses(trajectory), read_frame_poses(truth), None if frames is None else parse_frame_slice(frames)
    )
    estimated = rigid_alignment(pairs.estimated, pairs.truth) @ pairs.estimated if align else pairs.estimated
    figures = figures_of(trajectory_errors(estimated, pairs.truth))
    if pairs.without_truth:
        print_notice(f"{pairs.without_truth} frames have no true pose and are left out.")
    if pairs.beyond and frames is None:
        print_notice(
            f"{pairs.beyond} of the {len(pairs)} frames lie before the first or after the last pose and count as "
            "failures. If only some frames were localized, name the same --frames."
        )
    if pairs.by_time:
        print_notice("The poses were paired by their times, so frames without a pose are not counted.")
    if as_json:
        print_json(figures.as_dict())
    else:
        print_figures(f"{trajectory.name} against {truth.name}", figures.rows())
