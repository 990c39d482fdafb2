"""Pictures alone → the walk, up to its size."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rholoc.errors import MappingFailed
from rholoc.geometry import Camera, FloatArray, IntArray, Lens, on_plane, pose_matrix
from rholoc.geometry.graphs import components
from rholoc.trajectory.checks.agreement import Agreement, disputed
from rholoc.trajectory.frame.map_frame import up_by_pictures
from rholoc.trajectory.frame.waypoint_alignment import fix_frame
from rholoc.trajectory.initialization.global_positioning import global_positions
from rholoc.trajectory.initialization.mapper_starts import Mapper, PycolmapStarts
from rholoc.trajectory.initialization.rotation_averaging import average_rotations
from rholoc.trajectory.optimization.adjustment import adjust
from rholoc.trajectory.optimization.problem import GUESSED, State
from rholoc.trajectory.optimization.rounds import LAST_ITERATIONS, AdjustmentProgress
from rholoc.trajectory.optimization.zooms import measure_zooms, zoomed
from rholoc.trajectory.reconstruction.core import agreeing_cores
from rholoc.trajectory.reconstruction.depth_start import depth_start
from rholoc.trajectory.reconstruction.joining import with_pieces_joined
from rholoc.trajectory.reconstruction.measured_scale import scale_by_depth, scale_by_steps, scales_by_lengths
from rholoc.trajectory.reconstruction.outcome import WELL_PLACED, Reconstruction, finished
from rholoc.trajectory.reconstruction.pair_fit import MAX_PAIR_ERROR, pair_error
from rholoc.trajectory.reconstruction.part import (
    Part,
    Pictured,
    Start,
    adjusted_part,
    agreement_of,
    comparison_with,
    extended,
)
from rholoc.trajectory.reconstruction.reversal import unreversed
from rholoc.trajectory.reconstruction.sights import ADVICE, DENSER, MANY_FEATURES
from rholoc.trajectory.reconstruction.waypoints import in_map_frame
from rholoc.trajectory.visual.focal_guess import focal_by_matches
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.tracks import Observations, pieces_of

_POSITIONING_SIGHTINGS = 300  # per keyframe: more take time, and a hundred made a corridor's first positions worse
_ALL = 0.98  # share of the pictures that two reconstructions place alike, from which no third one is tried
_MAX_FOCAL_CONTRADICTION = 0.07  # of a given focal length, from which the pictures contradict it …
_SIGMAS = 4.0  # … and as many standard deviations of theirs
_FOCAL_FACTOR = 1.6  # by which the focal length of pairs contradicts a given one: correct ones differ by up to 1.25
_ZOOM_ROUNDS, _ZOOM_HASTE = 4, 1.5  # points follow the zooms of the pictures that show them
_MOST = 0.7  # share of a reconstruction's pictures that another one must confirm for it to be checked …
_MOST_OF_JOINED = 0.9  # … and of all pictures if pieces were joined to it, which no other one confirms
_MAX_ZOOM_SPREAD = 5.0  # per cent, of pictures by one lens: autofocus changes zooms by about 2
_ANOTHER_PLACE = 4  # minimum pictures of a separate component that may show another place
_WAYPOINTS_MISSED = (
    "The waypoints were not used: too few pictures at them could be placed. Take more pictures around each waypoint."
)
_SPACED = "Take pictures half a step apart, sideways where you can, and let each show half of the one before."
_LOOSE = 0.1  # pose uncertainty as a share of the extent, above which a reconstruction is useless


def solve_from_pictures(walk: Pictured, progress: AdjustmentProgress) -> Reconstruction:
    """Reconstruct the largest connected part of a walk from its pictures.

    Raises:
        MappingFailed: no two pictures overlap, or the waypoints contradict them.
    """
    whole = walk.observations()
    part = adjusted_part(walk, whole, _own_start(walk, whole), progress, (0.45, 0.75))
    return _finished(walk, part, progress)


def solve_from_set(walk: Pictured, progress: AdjustmentProgress) -> Reconstruction:
    """Reconstruct a set of pictures by up to four mappers, which check each other.

    Each mapper's first poses are adjusted to the same sightings, after the pictures that it left out are placed where
    they see enough points. The reconstruction of which another one confirms most pictures is taken. If it is confirmed,
    further pieces are joined to it. If fewer than 90 % of all pictures are confirmed, so are the pictures that another
    agreeing reconstruction adds. With joined pictures, fewer than 90 % leave the map untrusted: one that may be trusted
    without them gets none. Pictures that the confirming reconstruction places elsewhere are left out. If no other one
    confirms it, the pictures over which all reconstructions agree are taken instead, untrusted.

    Raises:
        MappingFailed: no mapper places anything, none agrees with another one to a tenth of the depth and all over too
            few pictures, these hardly overlap, or the waypoints contradict them.
    """
    whole = walk.observations()
    parts = _parts(walk, whole, progress)
    if not parts:
        raise MappingFailed("No two pictures overlap enough.", DENSER)
    agreement, _ = _best_agreement(_most_confirmed(parts, len(walk.sights.rows)), parts)
    found = None
    if agreement is not None and not agreement.same:
        found = _of_core(parts, walk, whole, progress)
        if found is None and agreement.contradicts:
            raise MappingFailed(f"Reconstructions of these pictures contradict each other: {agreement.why}", DENSER)
    if found is None:
        found = _best_of(parts, walk, whole, progress)
    return replace(found, note=f"{found.note} {_elsewhere(found, walk.evidence.sequential)}".strip())


def _parts(walk: Pictured, whole: Observations, progress: AdjustmentProgress) -> list[Part]:
    """The parts that the mappers place, until two agree on nearly all pictures.

    If no other part confirms a new one, all parts are tried with their depths reversed, each once. So are pycolmap's
    two if there is no other part: they have agreed on reversed depths.
    """
    sights, count = walk.sights, len(walk.sights.rows)
    pixels = [features.pixels.astype(np.float64) for features in sights.features]
    parts: list[Part] = []
    tried, has_ours = 0, False
    with PycolmapStarts(walk.camera, sights.camera is not None, pixels, walk.evidence.sequential) as starts:
        for number, mapper in enumerate(Mapper):
            if mapper is Mapper.OWN and not parts:  # which another one has to confirm
                starts.begin(Mapper.INCREMENTAL)
            span = 0.45 + 0.07 * number, 0.52 + 0.07 * number
            part = _placed_by(mapper, walk, whole, starts, progress, span)
            if part is None:
                continue
            parts.append(part)
            has_ours |= mapper in (Mapper.DEPTH, Mapper.OWN)
            if len(parts) > 1 and (not has_ours or _confirmed(_agreements(part, parts)) == 0):
                parts[tried:] = [unreversed(one, walk, whole, progress, span) for one in parts[tried:]]
                tried = len(parts)
            if _confirmed(_agreements(parts[-1], parts)) >= _ALL * count:
                break
    return parts


def _best_of(
    parts: Sequence[Part], walk: Pictured, whole: Observations, progress: AdjustmentProgress, grow: bool = True
) -> Reconstruction:
    """The part of which another one confirms most pictures, refined, with pieces joined if it is confirmed, in the map
    frame. Without ``grow`` no pictures are added. Raises MappingFailed if they hardly overlap, or miss the waypoints.
    """
    count = len(walk.sights.rows)
    best = _most_confirmed(parts, count)
    agreement, other = _best_agreement(best, parts)
    refined, walk, whole = _refined(best, walk, whole, progress, grow)
    part = refined
    if grow and agreement is not None and agreement.same:  # else a wrong part would grow
        pieces = [one for some in parts for one in some.apart]
        if agreement.common < _MOST_OF_JOINED * count:  # too few for a map with joined pictures to be trusted
            pieces = [] if _suffices(refined, walk, agreement) else [*_agreeing(best, parts), *pieces]
        part = with_pieces_joined(refined, pieces, walk, whole, progress)
    least = _MOST * len(part.members) if part is refined else _MOST_OF_JOINED * count
    if refined is not best:  # zooms of one that more features bend would be as wrong
        part = _unzoomed(part, other, walk, whole, progress)
    reached = [some for some in walk.waypoints if fix_frame(walk.sights.times[part.members], some)]
    found = _finished(replace(walk, waypoints=reached), part, progress)
    if walk.waypoints and not reached:
        found = replace(found, frame=replace(found.frame, doubts=(*found.frame.doubts, _WAYPOINTS_MISSED)))
    if _is_loose(found):
        raise MappingFailed("Too few points are seen by several pictures from places far enough apart.", _SPACED)
    found = replace(found, note=f"{found.note} {_by_waypoints(part.by_waypoints)}".strip())
    if agreement is None or other is None:
        return replace(found, agreement=Agreement(np.nan, np.nan, np.nan, 0, count))
    if agreement.common < least:
        return replace(found, agreement=Agreement(np.nan, np.nan, np.nan, agreement.common, len(part.members)))
    in_map_frame = comparison_with(found.T_map_camera, found.placed, found.median_depth, other)
    if in_map_frame.contradicts:  # what was adjusted since has bent it
        return replace(found, agreement=in_map_frame)
    found = replace(found, agreement=replace(agreement, second_positions=in_map_frame.second_positions))
    return _without_disputed(found) if agreement.same and in_map_frame.same else found


def _of_core(
    parts: Sequence[Part], walk: Pictured, whole: Observations, progress: AdjustmentProgress
) -> Reconstruction | None:
    """The reconstruction of the pictures over which all ``parts`` agree, untrusted; None if they are too few or hardly
    overlap, or miss the waypoints. Other pictures that at least one part places are disputed.
    """
    cores = agreeing_cores(parts, walk, whole, progress)
    try:
        found = _best_of(cores, walk, whole, progress, grow=False) if cores else None
    except MappingFailed:
        found = None
    if found is None:
        return None
    count = len(found.placed)
    disputed = np.isin(np.arange(count), np.concatenate([part.members for part in parts])) & ~found.placed
    why = f"Reconstructions agree on {int(found.placed.sum())} of {count} pictures only."
    frame = replace(found.frame, doubts=(*found.frame.doubts, why))
    return replace(found, frame=frame, disputed=disputed)


def _without_disputed(found: Reconstruction) -> Reconstruction:
    """Remove the pictures that the second reconstruction places elsewhere: both agree on the others, so that such a
    picture is wrong in one of them.
    """
    if found.agreement is None or found.agreement.second_positions is None:
        return found
    out = found.placed & disputed(found.T_map_camera, found.agreement.second_positions, found.median_depth)
    return replace(found, placed=found.placed & ~out, disputed=out)


def _suffices(part: Part, walk: Pictured, agreement: Agreement) -> bool:
    """Whether a part without joined pieces may be trusted: it places 90 % of the walk's pictures, of which another
    reconstruction confirms 70 %, and was taken at enough of its waypoints.
    """
    placed, count, times = len(part.members), len(walk.sights.rows), walk.sights.times[part.members]
    confirmed = placed >= WELL_PLACED * count and agreement.common >= _MOST * placed
    return confirmed and all(fix_frame(times, some) for some in walk.waypoints)


def _agreeing(best: Part, parts: Sequence[Part]) -> list[Start]:
    """Poses of the other parts that agree with the ``best`` and that no part contradicts; most inliers first."""
    found = [
        part
        for part in parts
        if part is not best and agreement_of(best, part).same and not _refuted(_agreements(part, parts))
    ]
    return [part.start for part in sorted(found, key=lambda part: -part.inliers)]


def _by_waypoints(pictures: Sequence[int]) -> str:
    """One line on pieces of so many ``pictures`` that the waypoints alone join; empty if there are none."""
    if not pictures:
        return ""
    sizes = ", ".join(str(one) for one in pictures[:-1])
    return f"Only the waypoints connect its pieces of {sizes} and {pictures[-1]} pictures."


def _elsewhere(found: Reconstruction, pairs: Sequence[VerifiedPair]) -> str:
    """One line if four or more of the pictures that are neither placed nor disputed are linked by pairs, as in sets of
    two rooms; else empty.
    """
    placed = found.placed if found.disputed is None else found.placed | found.disputed
    links = [(pair.first, pair.second) for pair in pairs if not (placed[pair.first] or placed[pair.second])]
    together = int(np.bincount(components(len(placed), np.array(links, dtype=np.int64))).max())
    if together < _ANOTHER_PLACE:
        return ""
    return f"{together} further pictures fit each other, but not these: perhaps of another place. Map them alone."


def _placed_by(
    mapper: Mapper,
    walk: Pictured,
    whole: Observations,
    starts: PycolmapStarts,
    progress: AdjustmentProgress,
    span: tuple[float, float],
) -> Part | None:
    """The part that a mapper places, adjusted; None if it places none or fails. ``whole`` are the sightings of all
    pictures, ``starts`` gives pycolmap's first poses, ``span`` the fractions of progress.
    """
    try:
        found = _starts_by(mapper, walk, whole, starts)
        if not found:
            return None
        middle = sum(span) / 2
        part = adjusted_part(walk, whole, found[0], progress, (span[0], middle))
        more = extended(part.start, walk, whole)
        if len(more[1]) > len(part.members):
            part = adjusted_part(walk, whole, more, progress, (middle, span[1]))
    except (MappingFailed, RuntimeError):  # gtsam's word for a system that cannot be solved
        return None
    return replace(part, in_metres=mapper is Mapper.DEPTH, apart=tuple(found[1:]))


def _starts_by(mapper: Mapper, walk: Pictured, whole: Observations, starts: PycolmapStarts) -> list[Start]:
    """First poses by a mapper: of its largest piece, then of smaller ones. Raises MappingFailed."""
    sights, camera = walk.sights, walk.camera
    if mapper is Mapper.OWN:
        return [_own_start(walk, whole)]
    if mapper is Mapper.DEPTH:
        if sights.depth is None:
            return []
        linked = depth_start(camera, sights.depth, walk.rays(), walk.evidence.sequential)
        return [] if linked is None else [(State(linked[0], np.zeros((0, 3)), camera), linked[1])]
    return [(State(T, np.zeros((0, 3)), found), members) for members, T, found in starts.pieces(mapper)]


def _refined(
    part: Part, walk: Pictured, whole: Observations, progress: AdjustmentProgress, grow: bool
) -> tuple[Part, Pictured, Observations]:
    """Adjust a part to more features and to the weak pairs that fit it; to ``grow`` it, add the pictures that these
    place.

    Returns the new part, the walk with the weak pairs used, and its sightings. If the adjustment fails or disagrees
    with ``part``, all three unchanged.
    """
    evidence = walk.evidence
    richer = replace(evidence, sequential=[*evidence.sequential, *_fitting(part, walk)], weak=[])
    more = walk.observed(richer, MANY_FEATURES)
    try:
        start = extended(part.start, walk, more) if grow else part.start
        found = adjusted_part(walk, more, start, progress, (0.75, 0.85))
    except (MappingFailed, RuntimeError):
        return part, walk, whole
    if not agreement_of(found, part).same:
        return part, walk, whole
    return found, replace(walk, evidence=richer), more


def _unzoomed(
    part: Part, other: Part | None, walk: Pictured, whole: Observations, progress: AdjustmentProgress
) -> Part:
    """The part, adjusted again with each picture's zoom estimated. Returns ``part`` itself if the zooms are alike, the
    camera is not a pinhole, the adjustment fails, or the ``other`` reconstruction contradicts the result.
    """
    if part.adjusted.state.camera.lens is not Lens.PINHOLE:
        return part
    found, zooms = part, np.ones(len(walk.sights.rows))
    for _ in range(_ZOOM_ROUNDS):
        problem = found.problem
        more, differ = measure_zooms(problem.observations, found.adjusted.state, problem.pixel_sigma_px)
        if not differ and found is part:
            break
        zooms[found.members] *= more**_ZOOM_HASTE
        try:
            corrected = zoomed(whole, zooms, found.adjusted.state.camera)
            found = adjusted_part(walk, corrected, found.start, progress, (0.85, 0.85), problem.fixes)
        except (MappingFailed, RuntimeError):
            return part
    if found is part or (other is not None and agreement_of(found, other).contradicts):
        return part
    return replace(found, zooms=zooms[found.members], by_waypoints=part.by_waypoints)


def _fitting(part: Part, walk: Pictured) -> list[VerifiedPair]:
    """Weak pairs of the walk that probably show one place, judged by the part's poses.

    Both pictures in the part: they are no farther apart than a clear pair of either, and their median epipolar error is
    at most 5e-3 of the focal length. Otherwise: both pictures have a clear pair with a picture of the part.
    """
    count = len(walk.sights.rows)
    T = np.full((count, 4, 4), np.nan)
    T[part.members] = part.adjusted.state.T_map_camera
    reach, beside = np.zeros(count), np.zeros(count, dtype=np.bool_)
    placed = np.isfinite(T[:, 0, 0])
    for pair in walk.evidence.sequential:
        beside[pair.first] |= placed[pair.second]
        beside[pair.second] |= placed[pair.first]
        apart = np.linalg.norm(T[pair.first, :3, 3] - T[pair.second, :3, 3])
        for k in (pair.first, pair.second):
            reach[k] = np.fmax(reach[k], apart)
    rays = walk.rays()
    found = []
    for pair in walk.evidence.weak:
        apart = np.linalg.norm(T[pair.first, :3, 3] - T[pair.second, :3, 3])
        if np.isnan(apart):
            found += [pair] if beside[pair.first] and beside[pair.second] else []
        elif apart <= max(reach[pair.first], reach[pair.second]) and pair_error(pair, rays, T) <= MAX_PAIR_ERROR:
            found.append(pair)
    return found


def _is_loose(found: Reconstruction) -> bool:
    """Whether there are no poses, or their median uncertainty is more than a tenth of their extent."""
    if not found.placed.any():
        return True
    variances = np.trace(found.covariances[found.placed, :3, :3], axis1=1, axis2=2)
    extent = np.linalg.norm(np.ptp(found.T_map_camera[found.placed, :3, 3], axis=0))
    return bool(np.median(np.sqrt(np.nan_to_num(variances, nan=np.inf))) > _LOOSE * extent)


def _most_confirmed(parts: Sequence[Part], count: int) -> Part:
    """The part with the most pictures confirmed by another part.

    Ties, if at least half of all ``count`` pictures are confirmed: parts in metres first, then the smallest. Otherwise:
    first parts of which no other one contradicts more pictures than are confirmed, then parts in metres, then the
    largest.
    """
    agreements = [_agreements(part, parts) for part in parts]
    confirmed = [_confirmed(found) for found in agreements]
    few = 2 * max(confirmed) < count

    def order(k: int) -> tuple[int, bool, bool, int]:
        part, much = parts[k], confirmed[k]
        refuted = few and 0 < much < _refuted(agreements[k])  # a part of it may be right, but not the whole
        return much, not refuted, part.in_metres, len(part.members) if few else -len(part.members)

    return parts[max(range(len(parts)), key=order)]


def _agreements(part: Part, parts: Sequence[Part]) -> list[Agreement]:
    """Agreement of a part with each of the other ``parts``."""
    return [agreement_of(part, other) for other in parts if other is not part]


def _confirmed(agreements: Sequence[Agreement]) -> int:
    """Largest number of a part's pictures that another one confirms; 0 if none agrees."""
    return max((one.common for one in agreements if one.same), default=0)


def _refuted(agreements: Sequence[Agreement]) -> int:
    """Largest number of a part's pictures over which another one contradicts it; 0 if none does."""
    return max((one.common for one in agreements if one.contradicts), default=0)


def _best_agreement(part: Part, parts: Sequence[Part]) -> tuple[Agreement | None, Part | None]:
    """Agreement with the other part that agrees best, and that part; both None if there is no other."""
    others = [other for other in parts if other is not part]
    if not others:
        return None, None
    found = _agreements(part, others)
    k = min(range(len(found)), key=lambda k: (not found[k].same, np.nan_to_num(found[k].distance, nan=np.inf)))
    return found[k], others[k]


def _finished(walk: Pictured, part: Part, progress: AdjustmentProgress) -> Reconstruction:
    """The part in the map frame, as a reconstruction of all pictures. Raises MappingFailed if it misses the
    waypoints.
    """
    sights = walk.sights
    up = up_by_pictures(part.adjusted.state.R_map_camera)
    members = sights.take(part.members)
    depth = scale_by_depth(part.problem, part.adjusted)
    driven = scale_by_steps(members.steps, part.adjusted)
    scales = scales_by_lengths(members.lengths, part.adjusted)
    scales += [one for one in (depth, driven) if one is not None]
    solved = in_map_frame(part.problem, part.adjusted, walk.waypoints, up, scales, (), progress)
    found = finished(solved, len(walk.evidence.loops), sights.camera is not None, None, walk.reason)
    if sights.camera is not None:
        doubts = (*found.frame.doubts, *_doubts_about_focal(part, walk, sights.camera))
        found = replace(found, frame=replace(found.frame, doubts=doubts))
    if part.zooms is not None:
        spread = 100 * float(np.std(part.zooms))
        found = replace(
            found, zooms=part.zooms, note=f"Autofocus zooms its pictures by {spread:.1f} %; this is corrected."
        )
        if spread > _MAX_ZOOM_SPREAD:
            why = "Its pictures' zooms differ by more than autofocus changes them. Calibrate the camera."
            found = replace(found, frame=replace(found.frame, doubts=(*found.frame.doubts, why)))
    if members.zooms is not None:
        others = ", ".join(f"{zoom:.2f}" for zoom in np.unique(members.zooms) if zoom != 1)
        note = f"Lenses of {others} times the focal length took some of its pictures. {found.note}".strip()
        found = replace(found, zooms=members.zooms * (1 if found.zooms is None else found.zooms), note=note)
    return _of_all(found, part.members, len(sights.rows))


def _doubts_about_focal(part: Part, walk: Pictured, given: Camera) -> tuple[str, ...]:
    """One line if the pictures contradict the focal length of the camera ``given``, else empty: their pairs by a factor
    of 1.6, or the part by 7 % and 4 sigmas, with the focal length free.
    """
    if part.problem.camera_sigmas is None:
        return ()
    by_pairs = _focal_by_pairs(walk, given)
    if by_pairs is not None and not 1 / _FOCAL_FACTOR < by_pairs / given.focal < _FOCAL_FACTOR:
        return (_contradicted(f"about {by_pairs:.0f} px", given),)
    problem = replace(part.problem, camera_sigmas=GUESSED)
    try:
        free = adjust(problem, part.adjusted.state, LAST_ITERATIONS, coarsely=True)
    except MappingFailed:
        return ()
    focal, sigma = free.state.camera.focal, float(free.camera_sigmas()[0])
    if not abs(focal - given.focal) > max(_SIGMAS * sigma, _MAX_FOCAL_CONTRADICTION * given.focal):
        return ()
    return (_contradicted(f"{focal:.0f} ± {sigma:.0f} px", given),)


def _focal_by_pairs(walk: Pictured, given: Camera) -> float | None:
    """Focal length [px] that pairs of the walk's pictures agree on; None if they do not agree."""

    def places(pixels: FloatArray) -> FloatArray:
        return on_plane(given.rays(pixels)) * given.focal

    return focal_by_matches([(places(a), places(b)) for a, b in walk.matched(0, 0)])


def _contradicted(measured: str, given: Camera) -> str:
    return (
        f"The pictures contradict the focal length that was given: {measured}, not {given.focal:.0f} px. "
        "Calibrate the camera, or leave it out to have it estimated."
    )


def _of_all(part: Reconstruction, members: IntArray, count: int) -> Reconstruction:
    """The reconstruction of the keyframes ``members`` (N,) as one of ``count`` keyframes, of which no others are
    placed.
    """
    placed = np.zeros(count, dtype=np.bool_)
    placed[members] = part.placed
    T = np.tile(np.eye(4), (count, 1, 1))
    T[members] = part.T_map_camera
    covariances = np.zeros((count, 6, 6))
    covariances[members] = part.covariances
    zooms = part.zooms
    if zooms is not None:
        zooms = np.ones(count)
        zooms[members] = part.zooms
    return replace(part, placed=placed, T_map_camera=T, covariances=covariances, zooms=zooms)


def _own_start(walk: Pictured, observations: Observations) -> Start:
    """First poses of the largest connected part by rotation averaging and global positioning, and its keyframes (N,).
    Raises MappingFailed if no two pictures overlap enough.
    """
    camera, count = walk.camera, len(walk.sights.rows)
    R, component = average_rotations(count, walk.evidence.rotations, walk.sights.times, None)
    piece = pieces_of(count, observations)
    both = component * (count + 1) + piece
    both[piece < 0] = -1
    kinds, sizes = np.unique(both[both >= 0], return_counts=True)
    if len(kinds) == 0:
        raise MappingFailed("No two pictures overlap enough.", ADVICE)
    members = np.flatnonzero(both == kinds[sizes.argmax()])
    positions = _positions_of(members, R, observations.thinned(_POSITIONING_SIGHTINGS), camera)
    return State(pose_matrix(R[members], positions), np.zeros((0, 3)), camera), members


def _positions_of(members: IntArray, R: FloatArray, observations: Observations, camera: Camera) -> FloatArray:
    """Positions (N, 3) of the ``members`` (N,) by global positioning of the points that at least two of them see. R (K,
    3, 3) are rotations of all keyframes. Raises MappingFailed.
    """
    number = np.full(len(R), -1)
    number[members] = np.arange(len(members))
    within = number[observations.keyframes] >= 0
    tracks = observations.tracks[within]
    often = np.bincount(tracks, minlength=observations.points)[tracks] >= 2
    rows = np.flatnonzero(within)[often]
    _, tracks = np.unique(observations.tracks[rows], return_inverse=True)
    rays = camera.rays(observations.pixels[rows])
    return global_positions(R[members], number[observations.keyframes[rows]], tracks, rays)
