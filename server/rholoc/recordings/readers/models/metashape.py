"""Cameras exported from Agisoft Metashape ("Export Cameras", Agisoft XML), beside the photos or in a folder above.

::

    cameras.xml    any name: document/chunk with
                   sensors/sensor: resolution, calibration (f, cx, cy from the image's centre, b1, k1 … k4, p1, p2)
                   components/component/transform, or transform: rotation, translation, scale
                   cameras/camera: sensor_id, component_id, label, transform (4×4, by rows)

A camera's transform is T_chunk_camera with OpenCV's camera axes; a component's takes the chunk to the reference, in
metres. Without it the unit of length is not stated, and components have no common frame: the cameras of the largest are
read. Of a geocentric reference only the scale is used. A photo is found by its label, with or without its suffix;
cameras that were not aligned are ignored, and so are those whose label another camera or several pictures have.
"""

from collections import Counter, defaultdict
from collections.abc import Collection, Container, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from rholoc.errors import InvalidCamera, InvalidRecording, InvalidTrajectory
from rholoc.geometry import Camera, FloatArray, Lens, is_rotation, pose_matrix
from rholoc.recordings.frames.image_decoding import IMAGE_SUFFIXES
from rholoc.recordings.readers._camera_models import CENTRE_SHIFT, three_coefficients, unsupported
from rholoc.recordings.readers._frames import UNREADABLE_SUFFIXES, unreadable, untimed_images
from rholoc.recordings.readers._orientation import as_shown
from rholoc.recordings.readers.models.colmap import SCALE_WARNING
from rholoc.recordings.recording import GivenPoses, Recording
from rholoc.recordings.tables.csv_table import read_text
from rholoc.reports import RecordingWarning, WarningKind

TABLES = ("*.xml", "*.psx", "*.files/*", "*.ply", "*.obj", "*.mtl")
_LENSES = {
    "frame": Lens.PINHOLE,
    "fisheye": Lens.FISHEYE,
    "equidistant_fisheye": Lens.FISHEYE,
    "spherical": Lens.EQUIRECTANGULAR,
}
_IGNORED = {  # coefficients that a calibration may have and a camera of the lens has not
    Lens.PINHOLE: ("b2", "p3", "p4"),
    Lens.FISHEYE: ("b2", "p1", "p2", "p3", "p4"),
    Lens.EQUIRECTANGULAR: (),
}
_ROTATION_TOLERANCE = 1e-3
_GEOCENTRIC_M = 1e6  # a component's distance from the origin, beyond which its frame is geocentric
_MAX_NAMED = 3
_ADVICE = "Export the cameras again, as Agisoft XML."


def recognises(folder: Path) -> bool:
    """Whether there is an XML file that lists a chunk's cameras."""
    return _document(folder) is not None


def read(folder: Path) -> Recording:
    """Read the aligned cameras and their photos; poses are metric if a transform with a scale is stated.

    Raises:
        InvalidRecording: no camera is aligned, none has a label of its own, or a photo is missing or broken.
        InvalidCamera: a calibration is broken.
        InvalidTrajectory: a transform is broken.
    """
    document = _document(folder)
    assert document is not None
    chunk, *others = (one for one in document.iterfind("chunk") if one.find("cameras") is not None)
    if others:
        raise InvalidRecording("The cameras' file has several chunks.", "Export the cameras of one chunk.")
    photos = _photos(folder, IMAGE_SUFFIXES)
    aligned = _aligned(chunk)
    missing = next((_label(one) for one in aligned if _label(one).lower() not in photos), None)
    if missing is not None:
        raise _no_photo(missing, folder)
    placed, label_warnings = _with_own_photos(aligned, list(chunk.iter("camera")), photos)
    frames = {one.get("id"): one.find("transform") for one in chunk.iter("component")}
    placed, frame_warnings = _in_one_frame(placed, {name for name, frame in frames.items() if frame is None})
    sensors = {sensor.get("id"): sensor for sensor in chunk.iter("sensor")}
    cameras, warnings = _cameras([sensors.get(one.get("sensor_id")) for one in placed])
    paths = [photos[_label(one).lower()][0] for one in placed]
    cameras, T_stored_shown = as_shown(paths, cameras)
    timed = untimed_images(paths, cameras)
    used = [_frame_of(one, frames, chunk) for one in placed]
    metric = any(one is not None and one.find("scale") is not None for one in used)
    T = np.array([_pose(one, frame) for one, frame in zip(placed, used, strict=True)]) @ T_stored_shown
    return Recording(
        timed.frames,
        camera=timed.camera,
        poses=GivenPoses(np.ones(len(T), dtype=np.bool_), T[timed.rows], metric=metric),
        warnings=(*timed.warnings, *label_warnings, *frame_warnings, *warnings, *(() if metric else (SCALE_WARNING,))),
    )


def _document(folder: Path) -> Element | None:
    """The first XML file of the folder that lists a chunk's cameras; None if there is none."""
    for path in sorted(folder.glob("*.xml")):
        try:
            root = ElementTree.fromstring(_without_entities(read_text(path)))
        except (ElementTree.ParseError, InvalidRecording):
            continue
        if root.tag == "document" and root.find("chunk/cameras") is not None:
            return root
    return None


def _without_entities(text: str) -> str:
    """The text; raises InvalidRecording if it defines entities, which may expand without bound."""
    if "<!ENTITY" in text:
        raise InvalidRecording("The XML file defines entities.", _ADVICE)
    return text


def _photos(folder: Path, suffixes: Container[str]) -> dict[str, list[Path]]:
    """Photos below the folder with such suffixes, by their lower-case names with and without suffix; hidden files and
    folders are not searched.
    """
    photos: dict[str, list[Path]] = defaultdict(list)
    for path in sorted(folder.rglob("*")):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if path.suffix.lower() in suffixes and path.is_file() and not hidden:
            for name in (path.stem, path.name):
                photos[name.lower()].append(path)
    return dict(photos)


def _label(camera: Element) -> str:
    """A camera's label; empty if it has none."""
    return camera.get("label", "")


def _aligned(chunk: Element) -> list[Element]:
    """The cameras of a chunk with a pose and a label. Raises InvalidRecording if there are none."""
    aligned = [one for one in chunk.iter("camera") if one.find("transform") is not None and _label(one)]
    if not aligned:
        raise InvalidRecording("The cameras' file has no aligned camera.", "Align the photos, then export the cameras.")
    return aligned


def _no_photo(label: str, folder: Path) -> InvalidRecording:
    """The error for a camera without a photo that can be read."""
    others = _photos(folder, UNREADABLE_SUFFIXES).get(label.lower())
    if others:
        return unreadable(others[0])
    return InvalidRecording(f"There is no photo {label[:60]}.", "Put the photos beside the cameras' file.")


def _with_own_photos(
    placed: Sequence[Element], cameras: Sequence[Element], photos: Mapping[str, Sequence[Path]]
) -> tuple[list[Element], tuple[RecordingWarning, ...]]:
    """The ``placed`` cameras whose label names one photo only, and a photo that none of the other ``cameras`` names;
    and a warning about the rest.

    Raises InvalidRecording if none is left.
    """
    uses = Counter(path for one in cameras for path in photos.get(_label(one).lower(), ()))
    own = [one for one in placed if sum(uses[path] for path in photos[_label(one).lower()]) == 1]
    if not own:
        hint = "Give each photo a name of its own, without copies or masks of that name, and export the cameras again."
        raise InvalidRecording("Every aligned camera shares its label with another camera or picture.", hint)
    shared = sorted({_label(one) for one in placed} - {_label(one) for one in own})
    if not shared:
        return own, ()
    more = f" and {len(shared) - _MAX_NAMED} more" if len(shared) > _MAX_NAMED else ""
    listed = ", ".join(label[:60] for label in shared[:_MAX_NAMED]) + more
    text = f"Cameras are left out whose label several cameras or pictures have: {listed}."
    return own, (RecordingWarning(WarningKind.NOT_USED, text),)


def _in_one_frame(
    placed: Sequence[Element], unplaced: Collection[str | None]
) -> tuple[list[Element], tuple[RecordingWarning, ...]]:
    """The largest set of cameras in one frame, and a warning about the rest.

    The cameras of each of the ``unplaced`` components have a frame of their own, all others share one.
    """
    of_camera = [component if (component := one.get("component_id")) in unplaced else None for one in placed]
    largest = Counter(of_camera).most_common(1)[0][0]
    kept = [one for one, component in zip(placed, of_camera, strict=True) if component == largest]
    if len(kept) == len(placed):
        return kept, ()
    text = f"Only the {len(kept)} cameras of the largest component are used: nothing places the others in its frame."
    return kept, (RecordingWarning(WarningKind.NOT_USED, text),)


def _frame_of(camera: Element, frames: Mapping[str | None, Element | None], chunk: Element) -> Element | None:
    """The transform of a camera's component, else of its chunk; None if neither is placed."""
    own = frames.get(camera.get("component_id"))
    return chunk.find("transform") if own is None else own


def _pose(camera: Element, frame: Element | None) -> FloatArray:
    """T_map_camera (4, 4) of a camera, moved and scaled by the transform ``frame``, only scaled by a geocentric one,
    unchanged for None. Raises InvalidTrajectory if a transform is no pose.
    """
    T = _numbers(camera.find("transform"), 16).reshape(4, 4)
    rotation, translation, scale = (
        None if frame is None else frame.find(n) for n in ("rotation", "translation", "scale")
    )
    factor = 1.0 if scale is None else float(_numbers(scale, 1)[0])
    R = np.eye(3) if rotation is None else _numbers(rotation, 9).reshape(3, 3)
    t = np.zeros(3) if translation is None else _numbers(translation, 3)
    if not (is_rotation(T[:3, :3], _ROTATION_TOLERANCE) and is_rotation(R, _ROTATION_TOLERANCE) and factor > 0):
        raise InvalidTrajectory(f"The transform of {str(camera.get('label'))[:60]} is not a pose.", _ADVICE)
    T[:3, 3] *= factor
    return T if np.linalg.norm(t) > _GEOCENTRIC_M else np.asarray(pose_matrix(R[None], t[None])[0] @ T)


def _numbers(element: Element | None, count: int) -> FloatArray:
    """Numbers (count,) in an element's text. Raises InvalidTrajectory for any other count."""
    try:
        found = np.array([float(word) for word in (element.text or "").split()] if element is not None else [])
    except ValueError:
        found = np.zeros(0)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise InvalidTrajectory(f"A transform is not {count} numbers.", _ADVICE)
    return found


def _cameras(sensors: Sequence[Element | None]) -> tuple[list[Camera] | None, tuple[RecordingWarning, ...]]:
    """Camera of each sensor, and a warning that names coefficients which cameras cannot have; None, with a warning, if
    a sensor is missing or of unknown type. Raises InvalidCamera.
    """
    known: dict[Element | None, Camera] = {}
    ignored: set[str] = set()
    for sensor in dict.fromkeys(sensors):
        kind = "unknown" if sensor is None else str(sensor.get("type", "frame"))
        if sensor is None or kind not in _LENSES:
            return None, (unsupported(kind),)
        known[sensor] = _camera(sensor, _LENSES[kind])
        ignored |= {name for name in _IGNORED[_LENSES[kind]] if _calibration(sensor).get(name)}
    text = f"The calibration's {', '.join(sorted(ignored))} cannot be used: poses may be a little off."
    warnings = (RecordingWarning(WarningKind.CAMERA_UNSUPPORTED, text),) if ignored else ()
    return [known[sensor] for sensor in sensors], warnings


def _calibration(sensor: Element) -> dict[str, float]:
    """Numbers of a sensor's adjusted calibration by name, else of its first one; empty if it has none. Raises
    InvalidCamera.
    """
    calibration = sensor.find("calibration[@class='adjusted']")
    calibration = sensor.find("calibration") if calibration is None else calibration
    numbers = [] if calibration is None else [one for one in calibration if one.tag != "resolution" and len(one) == 0]
    try:
        return {one.tag: float(one.text or "") for one in numbers}
    except ValueError as error:
        raise _no_calibration(sensor) from error


def _no_calibration(sensor: Element) -> InvalidCamera:
    """The error for a sensor without a valid calibration."""
    return InvalidCamera(f"The sensor {str(sensor.get('label'))[:60]} has no valid calibration.", _ADVICE)


def _camera(sensor: Element, lens: Lens) -> Camera:
    """Camera of a sensor. Raises InvalidCamera if it has no valid calibration."""
    resolution = sensor.find("resolution")
    size = {} if resolution is None else resolution.attrib
    try:
        width, height = int(size["width"]), int(size["height"])
        if lens is Lens.EQUIRECTANGULAR:
            return Camera.panorama(width, height)
        found = _calibration(sensor)
        focal = found["f"]
    except (KeyError, ValueError) as error:
        raise _no_calibration(sensor) from error
    cx, cy = width / 2 + found.get("cx", 0.0), height / 2 + found.get("cy", 0.0)
    centre = cx - CENTRE_SHIFT, cy - CENTRE_SHIFT
    camera = Camera(width, height, focal + found.get("b1", 0.0), focal, *centre, lens=lens)
    radial = [found.get(f"k{n}", 0.0) for n in (1, 2, 3, 4)]
    if lens is Lens.FISHEYE:
        return replace(camera, distortion=tuple(radial))
    k1, k2, k3 = three_coefficients(radial, camera)
    distortion = (k1, k2, found.get("p2", 0.0), found.get("p1", 0.0), k3)  # OpenCV has p1 and p2 the other way round
    return replace(camera, distortion=distortion if any(distortion) else ())
